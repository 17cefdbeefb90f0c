//! placeholder
use crate::{Result, case::CaseFile, output::RunFolder};
/// x
pub struct Report;
/// x
pub fn run<const D: usize>(_case: &CaseFile) -> Report {
    Report
}
impl Report {
    /// x
    pub fn write(&self, _folder: &RunFolder) -> Result<()> {
        Ok(())
    }
}
impl std::fmt::Display for Report {
    fn fmt(&self, _: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        Ok(())
    }
}
