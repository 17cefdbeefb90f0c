//! Option sets: lines as they are typed after a case.

use crate::{Error, Result};

/// Stands for no option at all.
const NONE: &str = "(none)";
/// The one option of ours that a set may hold, with its values.
const LAPLACIAN: &str = "scheme.laplacian";

/// One set of options.
#[derive(Debug, Clone, PartialEq)]
pub struct OptionSet {
    /// The line, blanks made single.
    pub line: String,
    /// PETSc's options and their values.
    pub petsc: Vec<String>,
    /// The equation without the correction of Eq. (3).
    pub uncorrected: bool,
}

impl OptionSet {
    /// Reads one line.
    ///
    /// # Errors
    /// [`Error::Input`] for what is neither an option of PETSc's nor the form of the equation.
    pub fn parse(line: &str) -> Result<Self> {
        let mut set = Self { line: String::new(), petsc: vec![], uncorrected: false };
        let line = if line.trim() == NONE { "" } else { line };
        let mut words = line.split_whitespace().peekable();
        while let Some(word) = words.next() {
            let wrong = |why: String| Error::Input(format!("option set {line:?}: {why}"));
            match word {
                "--set" => match words.next().and_then(|given| given.split_once('=')) {
                    Some((LAPLACIAN, "shao_lo")) => set.uncorrected = true,
                    Some((LAPLACIAN, "schwaiger")) => set.uncorrected = false,
                    _ => {
                        return Err(wrong(format!(
                            "of our own options only --set {LAPLACIAN}=shao_lo or schwaiger has a place in it"
                        )));
                    }
                },
                _ if is_option(word) => {
                    set.petsc.push(word.into());
                    set.petsc
                        .extend(words.next_if(|word| !is_option(word) && *word != "--set").map(Into::into));
                }
                _ => {
                    return Err(wrong(format!(
                        "{word} is no option: write them like -ksp_type cg -pc_type icc"
                    )));
                }
            }
        }
        set.line = line.split_whitespace().collect::<Vec<_>>().join(" ");
        if set.line.is_empty() {
            set.line = NONE.into();
        }
        Ok(set)
    }

    /// All sets of a text: one a line, comments and empty lines left out.
    ///
    /// # Errors
    /// As [`parse`](Self::parse).
    pub fn parse_all(text: &str) -> Result<Vec<Self>> {
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim());
        lines.filter(|line| !line.is_empty()).map(Self::parse).collect()
    }

    /// What follows the case on a command line.
    pub fn typed(&self) -> &str {
        if self.line == NONE { "" } else { &self.line }
    }
}

/// One dash and a letter; negative numbers are values.
fn is_option(word: &str) -> bool {
    word.len() > 2 && word.strip_prefix('-').is_some_and(|rest| rest.starts_with(char::is_alphabetic))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_is_a_line_as_typed() {
        let set = OptionSet::parse("  -ksp_type cg   -ksp_rtol -1e-3 -ksp_monitor").unwrap();
        assert_eq!(set.petsc, ["-ksp_type", "cg", "-ksp_rtol", "-1e-3", "-ksp_monitor"]);
        assert_eq!(set.line, "-ksp_type cg -ksp_rtol -1e-3 -ksp_monitor");
        let set = OptionSet::parse("-pc_type ilu --set scheme.laplacian=shao_lo").unwrap();
        assert!(set.uncorrected && set.petsc == ["-pc_type", "ilu"]);
        let none = OptionSet::parse("(none)").unwrap();
        assert!(none.petsc.is_empty() && none.typed().is_empty());
        for wrong in ["ksp_type cg", "--set spacing=1", "-ksp_type cg icc", "--spacing 1"] {
            assert!(matches!(OptionSet::parse(wrong), Err(Error::Input(_))), "{wrong}");
        }
    }

    #[test]
    fn the_catalogue_is_large_and_has_no_line_twice() {
        let sets = OptionSet::parse_all(super::super::CATALOGUE).unwrap();
        assert!(sets.len() >= 25, "{}", sets.len());
        for (k, set) in sets.iter().enumerate() {
            assert!(!sets[..k].contains(set), "{}", set.line);
        }
    }
}
