//! Numbers and summaries as people read and write them.

pub use vorofit::report::{count, significant};

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
