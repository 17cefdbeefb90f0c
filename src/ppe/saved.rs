//! Pressure systems in files of PETSc's binary format.
//!
//! A file holds eight objects in a row, of which those that were not assembled have size 0:
//! 1. the full operator and 2. the right-hand side in 1/s2, all that other PETSc programs read (`MatLoad`, `VecLoad`),
//! 3. the first guess in Pa, 4. the sparse, 5. the symmetric and 6. the uncorrected operator, 7. the right-hand side of the
//!    last, 8. for each row the number of its set of unknowns without a surface, from 1, or 0.
//!
//! The format (PETSc manual, "Viewers"): big-endian; a matrix is its class number, rows, columns, entries, the
//! length of each row, columns, values; a vector its class number, length, values. Integers are as wide as PETSc's own. It
//! needs no PETSc to be read.

use std::io::{self, BufReader, Read};
use std::path::Path;

use super::{Index, PressureSystem, Rows};
use crate::{Error, Result};

/// PETSc's class number of matrices in files.
const MATRIX: Index = 1_211_216;
/// PETSc's class number of vectors in files.
const VECTOR: Index = 1_211_214;

/// Reads a system; objects that its file ends before are left empty, as another program's file holds two.
///
/// # Errors
/// [`Error::Input`] for a file that cannot be read or is of another kind.
pub fn read(path: &Path) -> Result<PressureSystem> {
    let file = std::fs::File::open(path).map_err(|error| Error::unreadable(path, &error))?;
    let mut file = Objects(BufReader::with_capacity(1 << 20, file));
    let mut system = || -> io::Result<PressureSystem> {
        let mut system = PressureSystem {
            full: file.rows()?.ok_or_else(|| damaged("no matrix"))?,
            rhs: file.vector()?.ok_or_else(|| damaged("no right-hand side"))?,
            pressure: file.vector()?.unwrap_or_default(),
            sparse: file.rows()?.unwrap_or_default(),
            symmetric: file.rows()?.unwrap_or_default(),
            uncorrected: file.rows()?.unwrap_or_default(),
            uncorrected_rhs: file.vector()?.unwrap_or_default(),
            ..PressureSystem::default()
        };
        for (row, mark) in file.vector()?.unwrap_or_default().into_iter().enumerate() {
            if mark >= 1.0 && mark <= system.rhs.len() as f64 {
                let set = mark as usize;
                system.floating.resize(system.floating.len().max(set), vec![]);
                system.floating[set - 1].push(row as u32);
            }
        }
        Ok(system)
    };
    let mut system = system().map_err(|error| Error::unreadable(path, &error))?;
    let count = system.rhs.len();
    if system.full.len() != count || count == 0 {
        let why = format!("a matrix of {} rows and a right-hand side of {count}", system.full.len());
        return Err(Error::unreadable(path, &why));
    }
    // A system of another program has no pressure before it.
    system.pressure.resize(count, 0.0);
    Ok(system)
}

/// For each of `count` rows the number of its set, from 1, or 0; empty without sets.
pub fn marks(floating: &[Vec<u32>], count: usize) -> Vec<f64> {
    let mut marks = vec![0.0; if floating.is_empty() { 0 } else { count }];
    for (k, set) in floating.iter().enumerate() {
        set.iter().for_each(|&row| marks[row as usize] = (k + 1) as f64);
    }
    marks
}

fn damaged(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

/// A file of PETSc objects, read one after the other; none after its end.
struct Objects<R>(R);

impl<R: Read> Objects<R> {
    fn rows(&mut self) -> io::Result<Option<Rows>> {
        let Some([rows, columns, entries]) = self.header(MATRIX)? else { return Ok(None) };
        let lengths = self.integers(rows)?;
        let mut start: Vec<Index> = vec![0];
        for length in lengths {
            let end = start.last().and_then(|last| last.checked_add(length)).filter(|_| length >= 0);
            start.push(end.ok_or_else(|| damaged("row lengths"))?);
        }
        if rows != columns || start.last() != Some(&entries) {
            return Err(damaged("no square matrix"));
        }
        if rows == 0 {
            return Ok(Some(Rows::default()));
        }
        let column = self.integers(entries)?;
        if column.iter().any(|k| !(0..columns).contains(k)) {
            return Err(damaged("a column outside the matrix"));
        }
        Ok(Some(Rows { start, column, value: self.reals(entries)? }))
    }

    fn vector(&mut self) -> io::Result<Option<Vec<f64>>> {
        let Some([length]) = self.header(VECTOR)? else { return Ok(None) };
        self.reals(length).map(Some)
    }

    /// The numbers after the class number.
    fn header<const N: usize>(&mut self, class: Index) -> io::Result<Option<[Index; N]>> {
        let mut word = [0; size_of::<Index>()];
        match self.0.read_exact(&mut word) {
            Err(end) if end.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
            other => other?,
        }
        if Index::from_be_bytes(word) != class {
            return Err(damaged(match Index::BITS {
                32 => "not PETSc's binary format with 32-bit integers",
                _ => "not PETSc's binary format with 64-bit integers",
            }));
        }
        let numbers = self.integers(N as Index)?;
        Ok(numbers.try_into().ok())
    }

    fn integers(&mut self, count: Index) -> io::Result<Vec<Index>> {
        self.words(count, Index::from_be_bytes)
    }

    fn reals(&mut self, count: Index) -> io::Result<Vec<f64>> {
        self.words(count, f64::from_be_bytes)
    }

    /// A damaged count must not ask for more memory than the file is long: so it grows as it is read.
    fn words<const SIZE: usize, T>(
        &mut self,
        count: Index,
        convert: fn([u8; SIZE]) -> T,
    ) -> io::Result<Vec<T>> {
        let count = usize::try_from(count).map_err(|_| damaged("a negative count"))?;
        let mut bytes = vec![];
        self.0.by_ref().take((count * SIZE) as u64).read_to_end(&mut bytes)?;
        let (words, rest) = bytes.as_chunks::<SIZE>();
        if words.len() < count || !rest.is_empty() {
            return Err(damaged("it ends too early"));
        }
        Ok(words.iter().map(|word| convert(*word)).collect())
    }
}
