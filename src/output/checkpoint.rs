//! Complete states on disk: named arrays in one self-describing, checksummed file.
//!
//! Layout, all numbers little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 8 | the letters `SPHCKPT` and a zero |
//! | 4 | format version |
//! | 8 | length of the whole file |
//! | ... | text: version of the program that wrote it |
//! | ... | sections: text name, type (1 byte), number of elements (8 bytes), elements |
//! | 4 | CRC-32 of everything before |
//!
//! A text is its length in bytes (8 bytes) and its UTF-8. The first 20 and the last 4 bytes keep their
//! meaning in every format version, so that an old program can tell a newer file from a damaged one.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use super::folder::{make_subfolder, write_atomic};
use crate::{Error, Result};

const MAGIC: &[u8; 8] = b"SPHCKPT\0";
const FORMAT_VERSION: u32 = 1;
const LENGTH_AT: usize = 12;
const FRAME_HEAD: usize = 20;
const FRAME_TAIL: usize = 4;
/// How many checkpoints a run keeps: the newest, and one more in case that one is damaged.
const KEPT: usize = 2;

/// The content of a section.
#[derive(Debug, Clone, PartialEq)]
enum Data {
    F64(Vec<f64>),
    U64(Vec<u64>),
    U32(Vec<u32>),
    U8(Vec<u8>),
    Text(String),
}

/// Collects the sections of a checkpoint and saves them.
#[derive(Debug)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Default for Writer {
    fn default() -> Self {
        Self::new()
    }
}

impl Writer {
    /// A checkpoint without sections.
    pub fn new() -> Self {
        let mut writer = Self { bytes: MAGIC.to_vec() };
        writer.bytes.extend(FORMAT_VERSION.to_le_bytes());
        writer.bytes.extend([0; FRAME_HEAD - LENGTH_AT]);
        writer.put_text(env!("CARGO_PKG_VERSION"));
        writer
    }

    /// Adds doubles, bit by bit.
    pub fn f64(&mut self, name: &str, values: &[f64]) -> &mut Self {
        self.section(name, 0, values.len(), values.iter().flat_map(|x| x.to_le_bytes()))
    }

    /// Adds 64-bit integers.
    pub fn u64(&mut self, name: &str, values: &[u64]) -> &mut Self {
        self.section(name, 1, values.len(), values.iter().flat_map(|x| x.to_le_bytes()))
    }

    /// Adds 32-bit integers.
    pub fn u32(&mut self, name: &str, values: &[u32]) -> &mut Self {
        self.section(name, 2, values.len(), values.iter().flat_map(|x| x.to_le_bytes()))
    }

    /// Adds bytes.
    pub fn u8(&mut self, name: &str, values: &[u8]) -> &mut Self {
        self.section(name, 3, values.len(), values.iter().copied())
    }

    /// Adds a text.
    pub fn text(&mut self, name: &str, text: &str) -> &mut Self {
        self.section(name, 4, text.len(), text.bytes())
    }

    /// Saves as `step-0000123.ckpt` in `folder`, which is created, and removes checkpoints no longer needed.
    ///
    /// Needed are this one and the one before; later steps belong to a future that was given up on resume.
    pub fn save(mut self, folder: &Path, step: u64) -> Result<PathBuf> {
        let length = (self.bytes.len() + FRAME_TAIL) as u64;
        self.bytes[LENGTH_AT..FRAME_HEAD].copy_from_slice(&length.to_le_bytes());
        self.bytes.extend(crc32fast::hash(&self.bytes).to_le_bytes());

        make_subfolder(folder)?;
        let path = folder.join(format!("step-{step:07}.ckpt"));
        write_atomic(&path, |file| file.write_all(&self.bytes))?;

        let (later, kept): (Vec<_>, Vec<_>) = list(folder)?.into_iter().partition(|(s, _)| *s > step);
        for (_, path) in later.iter().chain(kept.iter().skip(KEPT)) {
            fs::remove_file(path).map_err(|error| Error::io(path, error))?;
        }
        Ok(path)
    }

    fn section(&mut self, name: &str, kind: u8, count: usize, data: impl Iterator<Item = u8>) -> &mut Self {
        self.put_text(name);
        self.bytes.push(kind);
        self.bytes.extend((count as u64).to_le_bytes());
        self.bytes.extend(data);
        self
    }

    fn put_text(&mut self, text: &str) {
        self.bytes.extend((text.len() as u64).to_le_bytes());
        self.bytes.extend(text.bytes());
    }
}

/// A checkpoint read back and checked.
#[derive(Debug, PartialEq)]
pub struct Reader {
    path: PathBuf,
    program_version: String,
    sections: BTreeMap<String, Data>,
}

impl Reader {
    /// Reads a checkpoint; whatever is wrong with it is an input error that names the older one beside it.
    pub fn load(path: &Path) -> Result<Self> {
        let refused = |why: String| {
            Error::Input(format!("the checkpoint {} {why}{}", path.display(), older_advice(path)))
        };
        let bytes = read_framed(path).map_err(refused)?;
        let (program_version, sections) = parse(&bytes[FRAME_HEAD..bytes.len() - FRAME_TAIL])
            .ok_or_else(|| refused("has a valid checksum but a content this version cannot read".into()))?;
        Ok(Self { path: path.to_owned(), program_version, sections })
    }

    /// Version of the program that wrote it.
    pub fn program_version(&self) -> &str {
        &self.program_version
    }

    /// Names of the sections, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.sections.keys().map(String::as_str)
    }

    /// Doubles, as they were written bit by bit.
    pub fn f64(&self, name: &str) -> Result<&[f64]> {
        match self.sections.get(name) {
            Some(Data::F64(values)) => Ok(values),
            other => Err(self.lacks("doubles", name, other)),
        }
    }

    /// 64-bit integers.
    pub fn u64(&self, name: &str) -> Result<&[u64]> {
        match self.sections.get(name) {
            Some(Data::U64(values)) => Ok(values),
            other => Err(self.lacks("64-bit integers", name, other)),
        }
    }

    /// 32-bit integers.
    pub fn u32(&self, name: &str) -> Result<&[u32]> {
        match self.sections.get(name) {
            Some(Data::U32(values)) => Ok(values),
            other => Err(self.lacks("32-bit integers", name, other)),
        }
    }

    /// Bytes.
    pub fn u8(&self, name: &str) -> Result<&[u8]> {
        match self.sections.get(name) {
            Some(Data::U8(values)) => Ok(values),
            other => Err(self.lacks("bytes", name, other)),
        }
    }

    /// A text.
    pub fn text(&self, name: &str) -> Result<&str> {
        match self.sections.get(name) {
            Some(Data::Text(text)) => Ok(text),
            other => Err(self.lacks("a text", name, other)),
        }
    }

    fn lacks(&self, wanted: &str, name: &str, found: Option<&Data>) -> Error {
        let path = self.path.display();
        let version = &self.program_version;
        let problem = if found.is_some() { "holds something else" } else { "is missing" };
        Error::Input(format!(
            "the checkpoint {path} should have {wanted} under {name:?}, which {problem}: it was written by \
             sphpetsc {version}, resume with that version"
        ))
    }
}

/// The newest checkpoint in a folder, if there is one.
pub fn latest(folder: &Path) -> Result<Option<PathBuf>> {
    Ok(list(folder)?.into_iter().next().map(|(_, path)| path))
}

/// Steps and paths of the checkpoints in a folder, the newest first.
fn list(folder: &Path) -> Result<Vec<(u64, PathBuf)>> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let failed = |error| Error::io(folder, error);
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        found.extend(step_of(&path).map(|step| (step, path)));
    }
    found.sort_by(|a, b| b.cmp(a));
    Ok(found)
}

fn step_of(path: &Path) -> Option<u64> {
    path.file_name()?.to_str()?.strip_prefix("step-")?.strip_suffix(".ckpt")?.parse().ok()
}

/// What to do when a checkpoint cannot be used.
fn older_advice(path: &Path) -> String {
    let older = step_of(path).zip(path.parent()).and_then(|(step, folder)| {
        list(folder).ok()?.into_iter().find(|(other, _)| *other < step).map(|(_, path)| path)
    });
    match older {
        Some(older) => format!("; to resume from the older {}, remove it", older.display()),
        None => "; there is no older one, start the run again".into(),
    }
}

/// The bytes of a file whose frame is whole, or what is wrong with it.
fn read_framed(path: &Path) -> std::result::Result<Vec<u8>, String> {
    let unreadable = |error: std::io::Error| format!("cannot be read: {error}");
    let mut file = File::open(path).map_err(unreadable)?;
    let actual = file.metadata().map_err(unreadable)?.len();

    // The head first: a foreign file may be of any size.
    let mut bytes = Vec::new();
    (&file).take(FRAME_HEAD as u64).read_to_end(&mut bytes).map_err(unreadable)?;
    let letters = bytes.len().min(MAGIC.len());
    if bytes[..letters] != MAGIC[..letters] {
        return Err("is no sphpetsc checkpoint".into());
    }
    if bytes.len() < FRAME_HEAD {
        return Err(format!("is truncated ({actual} bytes)"));
    }
    let length = u64::from_le_bytes(array(&bytes[LENGTH_AT..]));
    if actual < length {
        return Err(format!("is truncated ({actual} of {length} bytes)"));
    }
    if actual > length || length < (FRAME_HEAD + FRAME_TAIL) as u64 {
        return Err("is damaged (wrong length)".into());
    }
    file.read_to_end(&mut bytes).map_err(unreadable)?;
    let (content, checksum) = bytes.split_at(bytes.len() - FRAME_TAIL);
    if crc32fast::hash(content) != u32::from_le_bytes(array(checksum)) {
        return Err("is damaged (wrong checksum)".into());
    }
    let version = u32::from_le_bytes(array(&bytes[MAGIC.len()..]));
    if version != FORMAT_VERSION {
        return Err(format!(
            "has format {version}, this sphpetsc {} reads format {FORMAT_VERSION}: use the version that wrote it",
            env!("CARGO_PKG_VERSION")
        ));
    }
    Ok(bytes)
}

/// Program version and sections; `None` where a length or a type makes no sense.
fn parse(mut rest: &[u8]) -> Option<(String, BTreeMap<String, Data>)> {
    let program_version = take_text(&mut rest)?;
    let mut sections = BTreeMap::new();
    while !rest.is_empty() {
        let name = take_text(&mut rest)?;
        let kind = take(&mut rest, 1, 1)?[0];
        let count = take_count(&mut rest)?;
        let data = match kind {
            0 => Data::F64(
                take(&mut rest, count, 8)?.chunks(8).map(|x| f64::from_le_bytes(array(x))).collect(),
            ),
            1 => Data::U64(
                take(&mut rest, count, 8)?.chunks(8).map(|x| u64::from_le_bytes(array(x))).collect(),
            ),
            2 => Data::U32(
                take(&mut rest, count, 4)?.chunks(4).map(|x| u32::from_le_bytes(array(x))).collect(),
            ),
            3 => Data::U8(take(&mut rest, count, 1)?.to_vec()),
            4 => Data::Text(String::from_utf8(take(&mut rest, count, 1)?.to_vec()).ok()?),
            _ => return None,
        };
        if sections.insert(name, data).is_some() {
            return None;
        }
    }
    Some((program_version, sections))
}

/// Splits off `count` elements; `None` where there are not that many, before anything is allocated.
fn take<'a>(rest: &mut &'a [u8], count: usize, size: usize) -> Option<&'a [u8]> {
    rest.split_off(..count.checked_mul(size)?)
}

fn take_count(rest: &mut &[u8]) -> Option<usize> {
    usize::try_from(u64::from_le_bytes(array(take(rest, 8, 1)?))).ok()
}

fn take_text(rest: &mut &[u8]) -> Option<String> {
    let length = take_count(rest)?;
    String::from_utf8(take(rest, length, 1)?.to_vec()).ok()
}

/// The first `N` bytes.
fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    *bytes.first_chunk().expect("the caller took enough bytes")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Writer {
        let mut writer = Writer::new();
        writer
            .f64(
                "position",
                &[
                    0.1,
                    -0.0,
                    f64::NAN,
                    f64::INFINITY,
                    f64::MIN_POSITIVE / 3.0,
                    f64::from_bits(0x7ff8_dead_beef_0001),
                ],
            )
            .u64("id", &[0, u64::MAX])
            .u32("cell", &[u32::MAX, 7])
            .u8("kind", &[])
            .text("case", "name = \"Dammbruch mit Wänden\"\n");
        writer
    }

    fn message(path: &Path) -> String {
        match Reader::load(path) {
            Err(Error::Input(message)) => message,
            other => panic!("expected an input error, got {other:?}"),
        }
    }

    /// A file with this content between a correct frame.
    fn framed(path: &Path, format_version: u32, content: &[u8]) {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(format_version.to_le_bytes());
        bytes.extend(((FRAME_HEAD + content.len() + FRAME_TAIL) as u64).to_le_bytes());
        bytes.extend(content);
        bytes.extend(crc32fast::hash(&bytes).to_le_bytes());
        fs::write(path, bytes).unwrap();
    }

    #[test]
    fn everything_comes_back_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = sample().save(&folder.path().join("checkpoint"), 123).unwrap();
        assert!(path.ends_with("checkpoint/step-0000123.ckpt"));
        let reader = Reader::load(&path).unwrap();
        let bits: Vec<_> = reader.f64("position").unwrap().iter().map(|x| x.to_bits()).collect();
        let expected = [0.1, -0.0, f64::NAN, f64::INFINITY, f64::MIN_POSITIVE / 3.0].map(f64::to_bits);
        assert_eq!(bits[..5], expected);
        assert_eq!(bits[5], 0x7ff8_dead_beef_0001);
        assert_eq!(reader.u64("id").unwrap(), [0, u64::MAX]);
        assert_eq!(reader.u32("cell").unwrap(), [u32::MAX, 7]);
        assert!(reader.u8("kind").unwrap().is_empty());
        assert_eq!(reader.text("case").unwrap(), "name = \"Dammbruch mit Wänden\"\n");
        assert_eq!(reader.program_version(), env!("CARGO_PKG_VERSION"));
        assert_eq!(reader.names().collect::<Vec<_>>(), ["case", "cell", "id", "kind", "position"]);
        assert!(reader.f64("id").unwrap_err().to_string().contains("holds something else"));
        assert!(reader.u8("flag").unwrap_err().to_string().contains("is missing"));
    }

    #[test]
    fn any_flipped_bit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let whole = fs::read(sample().save(folder.path(), 1).unwrap()).unwrap();
        let path = folder.path().join("flipped.ckpt");
        for bit in 0..8 * whole.len() {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            fs::write(&path, bytes).unwrap();
            message(&path);
        }
    }

    #[test]
    fn any_truncation_or_addition_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let whole = fs::read(sample().save(folder.path(), 1).unwrap()).unwrap();
        let path = folder.path().join("cut.ckpt");
        for length in 0..whole.len() {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(message(&path).contains("truncated"), "{length}");
        }
        fs::write(&path, [&whole[..], b"x"].concat()).unwrap();
        assert!(message(&path).contains("damaged"));
    }

    #[test]
    fn foreign_newer_and_senseless_files_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.ckpt");
        fs::write(&path, "PK\x03\x04 something else").unwrap();
        assert!(message(&path).contains("no sphpetsc checkpoint"));
        framed(&path, FORMAT_VERSION + 1, b"what the future holds");
        assert!(message(&path).contains("use the version that wrote it"));
        assert!(message(&folder.path().join("absent.ckpt")).contains("cannot be read"));

        // Correctly framed, but with a count that no memory could hold.
        let section = |kind, count: u64| {
            let mut bytes = [0; 8].to_vec();
            bytes.extend(1_u64.to_le_bytes());
            bytes.extend([b'x', kind]);
            bytes.extend(count.to_le_bytes());
            bytes
        };
        for kind in 0..6 {
            for count in [1, u64::MAX / 8, u64::MAX / 8 + 1, u64::MAX] {
                framed(&path, FORMAT_VERSION, &section(kind, count));
                assert!(message(&path).contains("cannot read"));
            }
        }
    }

    #[test]
    fn the_newest_two_stay() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("checkpoint");
        assert_eq!(latest(&folder).unwrap(), None);
        let steps = || list(&folder).unwrap().into_iter().map(|(step, _)| step).collect::<Vec<_>>();
        for step in [1, 20, 300, 10_000_000] {
            sample().save(&folder, step).unwrap();
        }
        assert_eq!(steps(), [10_000_000, 300]);
        assert_eq!(latest(&folder).unwrap().unwrap(), folder.join("step-10000000.ckpt"));
        // Resumed from step 300 because the newest was damaged: its future is gone.
        sample().save(&folder, 400).unwrap();
        assert_eq!(steps(), [400, 300]);
    }

    #[test]
    fn a_damaged_one_offers_the_older() {
        let folder = tempfile::tempdir().unwrap();
        let older = sample().save(folder.path(), 1).unwrap();
        let newer = sample().save(folder.path(), 2).unwrap();
        let mut bytes = fs::read(&newer).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&newer, bytes).unwrap();
        let text = message(&newer);
        assert!(text.contains("wrong checksum") && text.contains(&older.display().to_string()), "{text}");
        fs::write(&older, "").unwrap();
        assert!(message(&older).contains("start the run again"));
    }
}
