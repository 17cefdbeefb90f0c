//! Particle files for ParaView: one VTP a snapshot, and a PVD that gives each its time in seconds.
//!
//! Positions are written as doubles; fields as single precision, which is what a picture needs at half
//! the size (checkpoints hold the exact state). VTK knows only three dimensions: in 2D, points get
//! z = 0 and vectors a third component of 0, so that glyphs and streamlines work. Every particle is also
//! a vertex cell: ParaView then draws them without a filter, and Threshold keeps or drops each one.

use std::fs;
use std::io::{self, Write};
use std::ops::Range;
use std::panic;
use std::path::{Path, PathBuf};

use vtkio::model::{
    Attribute, Attributes, ByteOrder, DataArray, DataSet, IOBuffer, Piece, PolyDataPiece, Scalar, Version,
    VertexNumbers, Vtk,
};
use vtkio::xml::Compressor;

use super::folder::{make_subfolder, write_atomic};
use crate::{Error, Result};

/// zlib level: higher ones take longer and gain less than 1 % on particle data.
const COMPRESSION_LEVEL: u32 = 1;

/// A file without particles: for these vtkio leaves out `NumberOfPoints`, without which VTK refuses a piece.
const EMPTY: &str = r#"<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"><PolyData>
<Piece NumberOfPoints="0" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="0"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii"></DataArray>
</Points></Piece></PolyData></VTKFile>
"#;

/// A named quantity with one value a particle.
#[derive(Debug, Clone, Copy)]
pub struct Field<'a> {
    /// Name in ParaView's lists.
    pub name: &'a str,
    /// The values, in the order of the positions.
    pub data: FieldData<'a>,
}

/// The values of a [`Field`].
#[derive(Debug, Clone, Copy)]
pub enum FieldData<'a> {
    /// One number a particle.
    Scalar(&'a [f64]),
    /// One vector a particle, flat, with this many components (at most 3).
    Vector(&'a [f64], usize),
    /// A small code a particle: kind, flag.
    Byte(&'a [u8]),
    /// A global number a particle.
    Id(&'a [u64]),
}

/// Surfaces as polygons.
#[derive(Debug, Clone, Default)]
pub struct Polygons {
    /// Three coordinates of each corner, in m.
    pub points: Vec<f64>,
    /// Three components of the velocity of each corner, in m/s.
    pub velocity: Vec<f64>,
    /// Corners of all polygons, one polygon behind the other.
    pub connectivity: Vec<u64>,
    /// Where each polygon ends there.
    pub offsets: Vec<u64>,
    /// Number of the body of each polygon.
    pub body: Vec<u64>,
    /// Three components of the liquid's force on the body of each polygon, in N.
    pub force: Vec<f64>,
}

/// Writes surfaces as text, which no reader of blocks can stumble over: they are small.
pub fn write_polygons(path: &Path, surfaces: Polygons) -> Result<()> {
    let Polygons { points, velocity, connectivity, offsets, body, force } = surfaces;
    let (corners, polygons) = (points.len() / 3, offsets.len());
    fn array<T: std::fmt::Debug>(kind: &str, name: &str, components: usize, values: &[T]) -> String {
        let values: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"ascii\">{}</DataArray>\n",
            values.join(" ")
        )
    }
    write_atomic(path, |file| {
        writeln!(file, r#"<?xml version="1.0"?>"#)?;
        writeln!(
            file,
            r#"<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64"><PolyData>"#
        )?;
        writeln!(
            file,
            r#"<Piece NumberOfPoints="{corners}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="{polygons}">"#
        )?;
        write!(file, "<PointData>{}</PointData>", array("Float64", "velocity", 3, &velocity))?;
        let (body, force) = (array("UInt64", "body", 1, &body), array("Float64", "force", 3, &force));
        write!(file, "<CellData>{body}{force}</CellData>")?;
        write!(file, "<Points>{}</Points>", array("Float64", "points", 3, &points))?;
        let (corners, ends) =
            (array("UInt64", "connectivity", 1, &connectivity), array("UInt64", "offsets", 1, &offsets));
        write!(file, "<Polys>{corners}{ends}</Polys></Piece></PolyData></VTKFile>")
    })
}

/// Writes particles at `positions` (flat, `dimension` coordinates each, in m) with their fields.
pub fn write_vtp(path: &Path, dimension: usize, positions: &[f64], fields: &[Field]) -> Result<()> {
    let count = positions.len() / dimension;
    if count == 0 {
        return write_atomic(path, |file| file.write_all(EMPTY.as_bytes()));
    }
    let pieces = pieces(count)
        .map(|range| Piece::Inline(Box::new(piece(range, dimension, positions, fields))))
        .collect();
    let vtk = Vtk {
        version: Version::new_xml(1, 0),
        title: String::new(),
        byte_order: ByteOrder::LittleEndian,
        file_path: None,
        data: DataSet::PolyData { meta: None, pieces },
    };
    let failed = |error: vtkio::xml::Error| io::Error::other(error.to_string());
    write_atomic(path, |file| {
        let file_model = vtk.try_into_xml_format(Compressor::ZLib, COMPRESSION_LEVEL).map_err(failed)?;
        file_model.write(file).map_err(failed)
    })
}

/// The particle ranges that are written as pieces of one file; VTK joins them again.
///
/// For an array of n times 32,768 bytes, vtkio 0.7.0-rc2 announces n + 1 full blocks, where the format
/// wants n. VTK 9.1 forgives that, a reader that trusts the table need not. Arrays here have 1, 4, 8, 12
/// or 24 bytes a particle, so only multiples of 4,096 particles meet it; giving the last one a piece of
/// its own avoids it.
fn pieces(count: usize) -> impl Iterator<Item = Range<usize>> {
    let split = if count.is_multiple_of(4096) { count.saturating_sub(1) } else { count };
    [0..split, split..count].into_iter().filter(|piece| !piece.is_empty())
}

fn piece(range: Range<usize>, dimension: usize, positions: &[f64], fields: &[Field]) -> PolyDataPiece {
    let count = range.len() as u64;
    let point = fields
        .iter()
        .map(|field| {
            let (components, data) = values(field, positions.len() / dimension, range.clone());
            Attribute::DataArray(DataArray::scalars(field.name, components).with_data(data))
        })
        .collect();
    PolyDataPiece {
        points: IOBuffer::F64(three_components(positions, dimension, range, |x| x)),
        verts: Some(VertexNumbers::XML {
            connectivity: (0..count).collect(),
            offsets: (1..=count).collect(),
        }),
        data: Attributes { point, cell: Vec::new() },
        ..Default::default()
    }
}

/// Number of components and values of the particles in `range`.
fn values(field: &Field, count: usize, range: Range<usize>) -> (u32, IOBuffer) {
    let check = |length| assert_eq!(length, count, "field {} has one value a particle", field.name);
    match field.data {
        FieldData::Scalar(data) => {
            check(data.len());
            (1, IOBuffer::F32(data[range].iter().map(|&x| x as f32).collect()))
        }
        FieldData::Vector(data, components) => {
            check(data.len() / components);
            (3, IOBuffer::F32(three_components(data, components, range, |x| x as f32)))
        }
        FieldData::Byte(data) => {
            check(data.len());
            (1, IOBuffer::U8(data[range].to_vec()))
        }
        FieldData::Id(data) => {
            check(data.len());
            (1, IOBuffer::U64(data[range].to_vec()))
        }
    }
}

fn three_components<T: Copy + Default>(
    flat: &[f64],
    components: usize,
    range: Range<usize>,
    convert: impl Fn(f64) -> T,
) -> Vec<T> {
    flat[range.start * components..range.end * components]
        .chunks_exact(components)
        .flat_map(|vector| {
            let mut padded = [T::default(); 3];
            padded.iter_mut().zip(vector).for_each(|(to, &from)| *to = convert(from));
            padded
        })
        .collect()
}

/// What [`read_vtp`] finds of the particles of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Stored {
    /// Three coordinates a particle, in m.
    pub positions: Vec<f64>,
    /// Three components a particle, in m/s.
    pub velocity: Vec<f64>,
    /// In Pa.
    pub pressure: Vec<f64>,
    /// Code of the kind of particle.
    pub kind: Vec<u8>,
    /// Global numbers.
    pub ids: Vec<u64>,
}

/// Reads particles that [`write_vtp`] wrote.
///
/// # Errors
/// [`Error::Input`] for a file that is damaged or lacks one of the quantities.
pub fn read_vtp(path: &Path) -> Result<Stored> {
    let damaged = |why: &str| Error::unreadable(path, &why);
    let bytes = fs::read(path).map_err(|error| damaged(&error.to_string()))?;
    // vtkio does not read a file without pieces, as VTK does.
    if bytes == EMPTY.as_bytes() {
        return Ok(Stored::default());
    }
    // It also trusts the numbers in front of an array, and panics where these are wrong.
    let parsed = panic::catch_unwind(|| Vtk::parse_xml(bytes.as_slice()));
    let Ok(Ok(Vtk { data: DataSet::PolyData { pieces, .. }, .. })) = parsed else {
        return Err(damaged("it is no whole VTP file"));
    };
    let mut all = Stored::default();
    for piece in pieces {
        let Piece::Inline(piece) = piece else { return Err(damaged("its pieces are elsewhere")) };
        let count = piece.num_points();
        all.positions.extend(numbers::<f64>(&piece.points, 3 * count).ok_or_else(|| damaged("no points"))?);
        let lacking = |name: &str| damaged(&format!("it has no whole array {name}"));
        all.velocity.extend(array::<f64>(&piece, "velocity", 3).ok_or_else(|| lacking("velocity"))?);
        all.pressure.extend(array::<f64>(&piece, "pressure", 1).ok_or_else(|| lacking("pressure"))?);
        all.kind.extend(array::<u8>(&piece, "kind", 1).ok_or_else(|| lacking("kind"))?);
        all.ids.extend(array::<u64>(&piece, "id", 1).ok_or_else(|| lacking("id"))?);
    }
    Ok(all)
}

fn array<T: Scalar>(piece: &PolyDataPiece, name: &str, components: usize) -> Option<Vec<T>> {
    let data = piece.data.point.iter().find_map(|attribute| match attribute {
        Attribute::DataArray(array) if array.name == name => Some(&array.data),
        _ => None,
    });
    numbers(data?, components * piece.num_points())
}

fn numbers<T: Scalar>(data: &IOBuffer, count: usize) -> Option<Vec<T>> {
    data.cast_into::<T>().filter(|values| values.len() == count)
}

/// Times in s and files of the collection at `path`; none if it does not exist.
///
/// # Errors
/// [`Error::Input`] if it cannot be read.
pub fn snapshots(path: &Path) -> Result<Vec<(f64, PathBuf)>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(path).map_err(|error| Error::unreadable(path, &error))?;
    let pvd = Pvd::create(path);
    let file = |(index, time)| (time, path.with_file_name(pvd.file(index)));
    Ok(times_in(&text).into_iter().enumerate().map(file).collect())
}

/// A collection `NAME.pvd` of the snapshots `NAME/NAME-000000.vtp`, ... with their times.
#[derive(Debug)]
pub struct Pvd {
    path: PathBuf,
    name: String,
    times: Vec<f64>,
}

impl Pvd {
    /// Starts the collection at `path`, whose extension is `pvd`; the first snapshot writes the file.
    pub fn create(path: &Path) -> Self {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Self { path: path.to_owned(), name, times: Vec::new() }
    }

    /// Continues a collection after its snapshots up to `time` in s; later ones are deleted.
    pub fn resume(path: &Path, time: f64) -> Result<Self> {
        let mut pvd = Self::create(path);
        if path.exists() {
            let text = fs::read_to_string(path).map_err(|error| Error::io(path, error))?;
            pvd.times = times_in(&text);
            let kept = pvd.times.iter().take_while(|&&t| t <= time).count();
            let dropped: Vec<_> = (kept..pvd.times.len()).map(|index| pvd.file(index)).collect();
            pvd.times.truncate(kept);
            pvd.write()?;
            for file in dropped.into_iter().map(|file| path.with_file_name(file)) {
                // Nothing names these files any more, and a new snapshot takes their place: one that
                // cannot be deleted does no harm.
                let _ = fs::remove_file(file);
            }
        }
        Ok(pvd)
    }

    /// Adds the snapshot of `time` in s, which `write` puts at the path it is given.
    ///
    /// A second snapshot of the same time replaces the first.
    pub fn snapshot(&mut self, time: f64, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
        self.times.pop_if(|last| *last == time);
        let path = self.path.with_file_name(self.file(self.times.len()));
        let folder = self.path.with_extension("");
        make_subfolder(&folder)?;
        write(&path)?;
        self.times.push(time);
        self.write()
    }

    /// Times of the snapshots in s.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Path of a snapshot relative to the collection.
    fn file(&self, index: usize) -> String {
        format!("{0}/{0}-{index:06}.vtp", self.name)
    }

    fn write(&self) -> Result<()> {
        write_atomic(&self.path, |file| {
            writeln!(file, r#"<?xml version="1.0"?>"#)?;
            writeln!(file, r#"<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">"#)?;
            writeln!(file, "  <Collection>")?;
            for (index, time) in self.times.iter().enumerate() {
                let name = self.file(index);
                writeln!(file, r#"    <DataSet timestep="{time:?}" part="0" file="{name}"/>"#)?;
            }
            writeln!(file, "  </Collection>")?;
            writeln!(file, "</VTKFile>")
        })
    }
}

/// Reads back the times that [`Pvd`] wrote.
fn times_in(text: &str) -> Vec<f64> {
    text.split(r#"timestep=""#).skip(1).filter_map(|rest| rest.split('"').next()?.parse().ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(folder: &Path) -> usize {
        fs::read_dir(folder.join("particles")).unwrap().count()
    }

    #[test]
    fn a_collection_keeps_exact_times_and_continues() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("particles.pvd");
        let mut pvd = Pvd::create(&path);
        let touch = |path: &Path| fs::write(path, "x").map_err(|error| Error::io(path, error));
        for time in [0.0, 0.1 + 0.2, 1e-7 + 0.5, 0.7] {
            pvd.snapshot(time, touch).unwrap();
        }
        assert_eq!(Pvd::resume(&path, 9.0).unwrap().times(), [0.0, 0.1 + 0.2, 1e-7 + 0.5, 0.7]);

        let mut pvd = Pvd::resume(&path, 0.1 + 0.2).unwrap();
        assert_eq!((pvd.times(), files(folder.path())), (&[0.0, 0.1 + 0.2][..], 2));
        pvd.snapshot(0.1 + 0.2, touch).unwrap();
        assert_eq!(pvd.times().len(), 2);
        pvd.snapshot(0.4, touch).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(r#"timestep="0.4" part="0" file="particles/particles-000002.vtp""#), "{text}");
        assert_eq!(files(folder.path()), 3);
    }

    #[test]
    fn no_array_is_a_multiple_of_the_block_size() {
        for count in [0, 1, 4095, 4096, 4097, 8192, 32_768, 98_304] {
            let sizes: Vec<_> = pieces(count).map(|piece| piece.len()).collect();
            assert_eq!(sizes.iter().sum::<usize>(), count);
            let bytes = |size| [1, 4, 8, 12, 24].map(|bytes| size * bytes);
            assert!(sizes.into_iter().flat_map(bytes).all(|bytes| bytes % 32_768 != 0), "{count}");
        }
    }
}
