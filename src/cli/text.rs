//! Numbers and summaries as people read and write them.

use vorofit::report::{QualityReport, Timing};
pub use vorofit::report::{count, significant};

/// What is said of a result that Ctrl-C cut short.
pub const INTERRUPTED: &str = "interrupted: this is the best so far";

/// Lines with a word before each; repeated words are written once.
#[derive(Default)]
pub struct Summary {
    text: String,
    last: &'static str,
}

impl Summary {
    /// Adds a line.
    pub fn line(&mut self, word: &'static str, content: impl AsRef<str>) {
        let shown = if word == self.last { "" } else { word };
        self.text += &format!("{shown:7} {}\n", content.as_ref());
        self.last = word;
    }

    /// Adds what was judged of that many elements of a volume.
    pub fn quality(&mut self, word: &'static str, elements: usize, quality: &QualityReport) {
        let valid = elements - quality.invalid - quality.undecided;
        self.line(
            word,
            format!(
                "{} valid everywhere, {} invalid, {} undecided; scaled Jacobian at least {}, mean {}",
                count(valid),
                count(quality.invalid),
                count(quality.undecided),
                significant(quality.scaled_jacobian_min, 3),
                significant(quality.scaled_jacobian_mean, 3)
            ),
        );
    }

    /// Adds the wall time of the whole and, where it was interrupted, that this is not its end.
    pub fn time(&mut self, timing: Option<&Timing>, is_interrupted: bool) {
        let seconds = timing.map_or(0.0, |timing| timing.total_s);
        let end = if is_interrupted {
            format!("; {INTERRUPTED}")
        } else {
            String::new()
        };
        self.line("time", format!("{seconds:.1} s{end}"));
    }

    /// All lines.
    pub fn text(self) -> String {
        self.text
    }
}

/// A finite number that satisfies a condition, or what clap should say.
pub fn parse_number(
    text: &str,
    is_allowed: impl Fn(f64) -> bool,
    range: &str,
) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && is_allowed(x) => Ok(x),
        _ => Err(format!("give a number {range}")),
    }
}

/// The command that runs this again.
pub fn command_line() -> String {
    let words = std::env::args_os().skip(1);
    let words = words.map(|word| word.to_string_lossy().into_owned());
    shell_line(std::iter::once("vorofit".into()).chain(words))
}

/// A command line that a POSIX shell takes apart into the same words.
fn shell_line(words: impl IntoIterator<Item = String>) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,@%+".contains(c);
    let quoted = |word: String| match !word.is_empty() && word.chars().all(plain) {
        true => word,
        false => format!("'{}'", word.replace('\'', r"'\''")),
    };
    words.into_iter().map(quoted).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_survive_the_shell() {
        let words = ["fit", "my scan.ply", "it's", "", "$(x)", "-o", "a=b"];
        assert_eq!(
            shell_line(words.map(String::from)),
            r"fit 'my scan.ply' 'it'\''s' '' '$(x)' -o a=b"
        );
    }
}
