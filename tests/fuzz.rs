//! Every parser of a user's file against damaged files: an answer or one sentence, never a panic, in bounded time and memory.
//!
//! A sample that is right is damaged by a list of edits, which proptest draws and, on a failure, shortens. By itself each test draws
//! a few hundred lists; `SPHPETSC_FUZZ_SECONDS=600` lets each go on for so long (`tools/fuzz`).

use std::cell::RefCell;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use sphpetsc::case::{builtin, read};
use sphpetsc::cli::{CaseArgs, ReportArgs, StudyArgs};
use sphpetsc::form::Mesh;
use sphpetsc::lab::sets::OptionSet;
use sphpetsc::output::checkpoint::{Reader, Writer};
use sphpetsc::output::comparison::References;
use sphpetsc::output::profiles;
use sphpetsc::page;
use sphpetsc::ppe::saved;
use sphpetsc::study::axes::Outline;

use crate::common::done;

/// Longest time that one file may take.
const LONGEST: Duration = Duration::from_secs(10);
/// Most memory that a test may take, in MB, beside what its sample takes.
const MOST_MEMORY: f64 = 1000.0;
/// Drawn lists of edits where nobody asks for more.
const CASES: u32 = 300;

/// One damage, at a share of the length.
#[derive(Debug, Clone)]
enum Edit {
    Cut(f64),
    Put(f64, Vec<u8>),
    Flip(f64, u8),
    /// Takes so many bytes out.
    Drop(f64, usize),
    /// Copies so many bytes from one place to another.
    Copy(f64, f64, usize),
    /// Puts a text in place of the number or word there.
    Replace(f64, String),
}

fn edit() -> impl Strategy<Value = Edit> {
    let numbers = [
        "0",
        "-1",
        "1e308",
        "-1e308",
        "1e-320",
        "nan",
        "inf",
        "-inf",
        "1e12",
        "18446744073709551616",
        "0x10",
        "1_000",
        "\"\"",
        "[]",
        "{}",
        "true",
        "[[",
        "]]",
        "\u{0}",
        "é",
        "\\",
        "\n",
        "=",
        "#",
    ];
    let place = 0.0..1.0;
    prop_oneof![
        1 => place.clone().prop_map(Edit::Cut),
        2 => (place.clone(), vec(any::<u8>(), 1..9)).prop_map(|(at, bytes)| Edit::Put(at, bytes)),
        2 => (place.clone(), any::<u8>()).prop_map(|(at, bits)| Edit::Flip(at, bits)),
        2 => (place.clone(), 1_usize..64).prop_map(|(at, count)| Edit::Drop(at, count)),
        2 => (place.clone(), place.clone(), 1_usize..200).prop_map(|(from, to, count)| Edit::Copy(from, to, count)),
        6 => (place, proptest::sample::select(numbers.to_vec())).prop_map(|(at, text)| Edit::Replace(at, text.into())),
    ]
}

impl Edit {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let place = |share: f64, bytes: &Vec<u8>| (share * bytes.len() as f64) as usize;
        match self {
            Self::Cut(at) => bytes.truncate(place(*at, bytes)),
            Self::Put(at, what) => {
                let at = place(*at, bytes);
                bytes.splice(at..at, what.iter().copied());
            }
            Self::Flip(at, bits) => {
                let at = place(*at, bytes);
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= bits;
                }
            }
            Self::Drop(at, count) => {
                let at = place(*at, bytes);
                bytes.drain(at..(at + count).min(bytes.len()));
            }
            Self::Copy(from, to, count) => {
                let (from, to) = (place(*from, bytes), place(*to, bytes));
                let part = bytes[from..(from + count).min(bytes.len())].to_vec();
                bytes.splice(to..to, part);
            }
            Self::Replace(at, text) => {
                let belongs = |byte: &u8| byte.is_ascii_alphanumeric() || b".+-_".contains(byte);
                let mut start = place(*at, bytes);
                // To the next word, and to its end.
                start += bytes[start..].iter().position(belongs).unwrap_or(0);
                let end = start
                    + bytes[start..].iter().position(|byte| !belongs(byte)).unwrap_or(bytes.len() - start);
                bytes.splice(start..end, text.bytes());
            }
        }
    }
}

/// Damages one of `samples` again and again, and lets `parse` read it.
fn fuzz(samples: &[Vec<u8>], parse: impl Fn(&[u8])) {
    fuzz_some(CASES, samples, |_, bytes| parse(bytes));
}

/// [`fuzz`] for what takes long to read; `parse` is told which of the samples it gets.
fn fuzz_some(cases: u32, samples: &[Vec<u8>], parse: impl Fn(usize, &[u8])) {
    let seconds = std::env::var("SPHPETSC_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    let until = Instant::now() + Duration::from_secs(seconds.unwrap_or(0));
    let memory = sphpetsc::memory::peak_mb();
    let lists = (0..samples.len(), vec(edit(), 0..6));
    let runs = RefCell::new(0_u64);
    loop {
        let mut runner = TestRunner::new(Config { cases, failure_persistence: None, ..Config::default() });
        let outcome = runner.run(&lists, |(sample, edits)| {
            let mut bytes = samples[sample].clone();
            edits.iter().for_each(|edit| edit.apply(&mut bytes));
            let begun = Instant::now();
            parse(sample, &bytes);
            prop_assert!(begun.elapsed() < LONGEST, "took {:?}", begun.elapsed());
            *runs.borrow_mut() += 1;
            Ok(())
        });
        if let Err(failure) = outcome {
            panic!("{failure}");
        }
        if Instant::now() >= until {
            break;
        }
    }
    if let (Some(before), Some(after)) = (memory, sphpetsc::memory::peak_mb()) {
        assert!(after - before < MOST_MEMORY, "{after} MB");
    }
    println!("{} damaged files", runs.borrow());
}

/// Lets `parse` read damaged files from a path.
fn fuzz_files(samples: &[Vec<u8>], parse: impl Fn(&Path)) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged");
    fuzz(samples, |bytes| {
        fs::write(&path, bytes).unwrap();
        parse(&path);
    });
}

#[test]
fn case_files() {
    let samples: Vec<Vec<u8>> = builtin::names().map(|name| builtin::find(name).unwrap().into()).collect();
    fuzz(&samples, |bytes| {
        // Its file is read as text first.
        let _ = read::read(&String::from_utf8_lossy(bytes), "damaged.toml", &[]);
    });
}

#[test]
fn triangle_meshes() {
    let text = "solid s\n".to_owned()
        + &[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
            .map(|corners| {
                let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
                let corner =
                    |k: usize| format!("vertex {} {} {}\n", points[k][0], points[k][1], points[k][2]);
                format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", corners.map(corner).concat())
            })
            .concat()
        + "endsolid s\n";
    assert!(Mesh::read(text.as_bytes(), 1.0, Default::default()).is_ok());
    let mut binary = vec![b' '; 80];
    binary.extend(2_u32.to_le_bytes());
    binary.extend([0; 100]);
    fuzz(&[text.into_bytes(), binary], |bytes| {
        let _ = Mesh::read(bytes, 1.0, Default::default());
    });
}

#[test]
fn checkpoints() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::new();
    writer.f64("position", &[1.0, 2.0]).u64("step", &[7]).text("case", "name = \"x\"");
    let sample = fs::read(writer.save(folder.path(), 7).unwrap()).unwrap();
    fuzz_files(&[sample], |path| {
        let _ = Reader::load(path);
    });
}

#[test]
fn measured_series() {
    let case = read::read(builtin::find("dam_break_2d").unwrap(), "dam_break_2d", &[]).unwrap();
    let head = "t_n_sqrt_g_over_a_nd,front_z_over_a_nd\n";
    let rows: String =
        (0..20).map(|k| format!("{},{}\n", 0.1 * f64::from(k), 1.0 + 0.2 * f64::from(k))).collect();
    fuzz_files(&[(head.to_owned() + &rows).into_bytes()], |path| {
        let _ = References::read(&case, &[(&case.references[0], path)]);
    });
}

#[test]
fn measured_surfaces() {
    let case = read::read(builtin::find("dam_break_wet_bed").unwrap(), "dam_break_wet_bed", &[]).unwrap();
    let profile = case.profile.as_ref().unwrap();
    let head =
        [&profile.time_column, &profile.x_column, &profile.height_column].map(String::as_str).join(",");
    let rows: String = (0..20).map(|k| format!("\n{},{},0.1", k / 5, 0.1 * f64::from(k))).collect();
    fuzz_files(&[(head + &rows).into_bytes()], |path| {
        let _ = profiles::read(profile, path);
    });
}

#[test]
fn saved_systems() {
    let folder = tempfile::tempdir().unwrap();
    let be = |numbers: &[i32]| numbers.iter().flat_map(|n| n.to_be_bytes()).collect::<Vec<u8>>();
    let values = |numbers: &[f64]| numbers.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<u8>>();
    let matrix = [be(&[1_211_216, 2, 2, 3, 2, 1, 0, 1, 1]), values(&[2.0, -1.0, 1.0])].concat();
    let vector = [be(&[1_211_214, 2]), values(&[1.0, 0.5])].concat();
    let sample = [
        matrix.clone(),
        vector.clone(),
        vector.clone(),
        matrix.clone(),
        matrix.clone(),
        matrix,
        vector.clone(),
        vector,
    ]
    .concat();
    let path = folder.path().join("right");
    fs::write(&path, &sample).unwrap();
    if size_of::<sphpetsc::ppe::Index>() == 4 {
        assert_eq!(saved::read(&path).unwrap().rhs, [1.0, 0.5]);
    }
    fuzz_files(&[sample], |path| {
        let _ = saved::read(path);
    });
}

#[test]
fn lists_of_solver_options() {
    let sample = "# mine\n-ksp_type cg -pc_type hypre\nname: -ksp_type bcgs -pc_type ilu -ksp_rtol 1e-6\n";
    fuzz(&[sample.into()], |bytes| {
        let _ = OptionSet::parse_all(&String::from_utf8_lossy(bytes));
    });
}

#[test]
fn study_files() {
    let studies = Path::new(env!("CARGO_MANIFEST_DIR")).join("cases/studies");
    let files = fs::read_dir(studies).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = files.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
    files.sort();
    assert!(files.len() > 5);
    let samples: Vec<_> = files.iter().map(|path| fs::read(path).unwrap()).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.toml");
    fuzz(&samples, |bytes| {
        fs::write(&path, bytes).unwrap();
        let common = CaseArgs { case: Some(path.to_str().unwrap().into()), ..CaseArgs::default() };
        let args = StudyArgs { common, ..StudyArgs::default() };
        let _ = Outline::of(&args).and_then(|outline| outline.points(&args, &folder.path().join("out")));
    });
}

/// One file of a run at a time; each may be right still, so that a page comes of it.
#[test]
fn folders_of_runs() {
    let folder = tempfile::tempdir().unwrap();
    let line = "dam_break_3d_fixed --scheme wcsph --spacing 0.11 --until 0.02 --set output.particles=0.01 --threads 1";
    done(&folder, &format!("{line} --out run -q"));
    let run = folder.path().join("run");
    let mut files: Vec<_> = [run.clone(), run.join("particles")]
        .iter()
        .flat_map(|folder| fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    assert!(files.len() > 6, "{files:?}");
    let samples: Vec<_> = files.iter().map(|path| fs::read(path).unwrap()).collect();
    let args = ReportArgs { folder: run, quiet: true };
    page::write(&args).unwrap();
    fuzz_some(CASES / 3, &samples, |k, bytes| {
        fs::write(&files[k], bytes).unwrap();
        let _ = page::write(&args);
        fs::write(&files[k], &samples[k]).unwrap();
    });
    page::write(&args).unwrap();
}

/// PETSc reads them as it starts, which it does once in a process.
#[test]
#[cfg(feature = "petsc")]
fn files_of_petsc_options() {
    let sample = "# mine\n-ksp_type cg\n-pc_type hypre\n-pc_hypre_boomeramg_strong_threshold 0.5 -ksp_rtol 1e-6\n\
                  -ksp_max_it 30\n-ksp_monitor\n";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("options");
    fuzz_some(CASES / 10, &[sample.into()], |_, bytes| {
        fs::write(&path, bytes).unwrap();
        let output = crate::common::run(&folder, "check dam_break_2d -options_file options");
        if output.status.code() != Some(0) {
            crate::common::sentence(&output, 2);
        }
    });
}
