//! Particle files as other programs meet them: read back by vtkio, by hand, and by VTK itself where installed.

use std::path::Path;
use std::process::Command;

use sphpetsc::output::{Field, FieldData, Pvd, write_vtp};
use vtkio::model::{Attribute, DataSet, PolyDataPiece, Vtk};

/// Where compressed VTK files go wrong: nothing, one, and byte counts at and around n times 32,768.
const COUNTS: [usize; 9] = [0, 1, 2, 4095, 4096, 4097, 8192, 32_768, 40_000];

/// Particles whose every number says which particle it is.
struct Sample {
    dimension: usize,
    position: Vec<f64>,
    velocity: Vec<f64>,
    pressure: Vec<f64>,
    kind: Vec<u8>,
    id: Vec<u64>,
}

impl Sample {
    fn new(dimension: usize, count: usize) -> Self {
        let flat = |scale: f64| (0..dimension * count).map(|i| scale * i as f64).collect();
        Self {
            dimension,
            position: flat(0.1),
            velocity: flat(0.5),
            pressure: (0..count).map(|i| -0.25 * i as f64).collect(),
            kind: (0..count).map(|i| (i % 3) as u8).collect(),
            id: (0..count).map(|i| (1 << 40) + i as u64).collect(),
        }
    }

    fn write(&self, path: &Path) {
        let fields = [
            Field { name: "velocity", data: FieldData::Vector(&self.velocity, self.dimension) },
            Field { name: "pressure", data: FieldData::Scalar(&self.pressure) },
            Field { name: "kind", data: FieldData::Byte(&self.kind) },
            Field { name: "id", data: FieldData::Id(&self.id) },
        ];
        write_vtp(path, self.dimension, &self.position, &fields).unwrap();
    }
}

/// `flat` with a third component of 0 in 2D.
fn padded(flat: &[f64], dimension: usize) -> Vec<f64> {
    flat.chunks(dimension).flat_map(|v| [v[0], v[1], v.get(2).copied().unwrap_or(0.0)]).collect()
}

fn values(pieces: &[PolyDataPiece], name: &str) -> Vec<f64> {
    let array = |attribute: &Attribute| match attribute {
        Attribute::DataArray(array) if array.name == name => Some(array.data.cast_into::<f64>().unwrap()),
        _ => None,
    };
    pieces.iter().flat_map(|piece| piece.data.point.iter().find_map(array).unwrap()).collect()
}

#[test]
fn particles_come_back_through_vtkio() {
    let folder = tempfile::tempdir().unwrap();
    for dimension in [2, 3] {
        // Without the 0: vtkio does not read a file without pieces, as VTK does.
        for count in COUNTS.into_iter().filter(|&count| count > 0) {
            let path = folder.path().join("particles.vtp");
            let sample = Sample::new(dimension, count);
            sample.write(&path);
            let DataSet::PolyData { pieces, .. } = Vtk::import(&path).unwrap().data else {
                panic!("{count}: no poly data")
            };
            let pieces: Vec<_> =
                pieces.into_iter().map(|piece| piece.into_loaded_piece_data(None).unwrap()).collect();
            let points: Vec<f64> =
                pieces.iter().flat_map(|piece| piece.points.cast_into::<f64>().unwrap()).collect();
            assert_eq!(points, padded(&sample.position, dimension), "{count}");
            assert_eq!(values(&pieces, "velocity"), padded(&sample.velocity, dimension), "{count}");
            assert_eq!(values(&pieces, "pressure"), sample.pressure, "{count}");
            let id: Vec<u64> = values(&pieces, "id").into_iter().map(|x| x as u64).collect();
            assert_eq!(id, sample.id, "{count}");
            assert_eq!(pieces.iter().map(PolyDataPiece::num_verts).sum::<usize>(), count);
        }
    }
}

/// Against the format itself: VTK and vtkio forgive a wrong table of blocks in front of an array.
#[test]
fn block_tables_match_the_particle_counts() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("particles.vtp");
    // Without particles there are no blocks.
    for count in COUNTS.into_iter().filter(|count| *count > 0) {
        Sample::new(3, count).write(&path);
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(r#"header_type="UInt64""#));
        for piece in text.split("<Piece ").skip(1) {
            let points: u64 = attribute(piece, "NumberOfPoints").map_or(0, |n| n.parse().unwrap());
            for array in piece.split("<DataArray ").skip(1) {
                let size = match attribute(array, "type").unwrap() {
                    "UInt8" => 1,
                    "Float32" => 4,
                    "Float64" | "UInt64" => 8,
                    other => panic!("unexpected type {other}"),
                };
                let components: u64 =
                    attribute(array, "NumberOfComponents").map_or(1, |n| n.parse().unwrap());
                let (_, data) = array.split_once('>').unwrap();
                let data = data.split('<').next().unwrap().trim();
                let expected = points * components * size;
                let header = leading_numbers(data);
                let announced = match header[..] {
                    [blocks, block_size, 0] => blocks * block_size,
                    [blocks, block_size, last] => (blocks - 1) * block_size + last,
                    _ => panic!("{count}: header {header:?}"),
                };
                assert_eq!(announced, expected, "{count}");
            }
        }
    }
}

fn attribute<'a>(element: &'a str, name: &str) -> Option<&'a str> {
    let (tag, _) = element.split_once('>')?;
    let (_, rest) = tag.split_once(&format!("{name}=\""))?;
    rest.split('"').next()
}

/// The first three 64-bit numbers of base64 data.
fn leading_numbers(base64: &str) -> Vec<u64> {
    const ALPHABET: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut bytes = Vec::new();
    for group in base64.as_bytes().chunks(4).take(8) {
        let digits = group.iter().map_while(|&c| ALPHABET.find(char::from(c)));
        let (mut bits, mut count) = (0_u32, 0);
        for digit in digits {
            bits |= (digit as u32) << (18 - 6 * count);
            count += 1;
        }
        bytes.extend(&bits.to_be_bytes()[1..count.max(1)]);
    }
    bytes.chunks_exact(8).map(|bytes| u64::from_le_bytes(bytes.try_into().unwrap())).collect()
}

/// The way a user goes: open the collection in ParaView, with its own readers. Pictures need a display and are left to
/// `tools/paraview_check.py --png`.
#[test]
fn paraview_opens_the_collection() {
    let installed = |program: &str| Command::new(program).arg("--help").output().is_ok();
    if !installed("pvpython") {
        eprintln!("skipped: no pvpython (Debian packages paraview and python3-paraview)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut pvd = Pvd::create(&folder.path().join("particles.pvd"));
    for (index, count) in COUNTS.into_iter().enumerate() {
        let sample = Sample::new(2 + index % 2, count);
        pvd.snapshot(0.1 * index as f64, |path| {
            sample.write(path);
            Ok(())
        })
        .unwrap();
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/paraview_check.py");
    let counts = COUNTS.map(|n| n.to_string());
    let output = Command::new("pvpython")
        .arg(script)
        .arg(folder.path())
        .arg("--counts")
        .args(counts)
        .output()
        .unwrap();
    let said =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.contains("ERR"), "{said}");
}
