//! Shader texts: plain WGSL files joined behind a generated header, with errors told in the files' own lines.
//!
//! The header holds the constants of a variant (a workgroup size, a switch) and the structs that the host shares with the
//! shader. Those are declared once, in Rust, by [`shared_struct!`](shared_struct), and written out as WGSL here.

use crate::error::{Error, Result};
use std::fmt::Write;

/// Threads a workgroup, in every kernel.
pub const WORKGROUP_SIZE: u32 = 64;

/// The values of a variant's constants, by name; `u32` in the shader.
pub type Constants<'a> = &'a [(&'static str, u32)];

/// A WGSL file that is built into the program.
#[derive(Debug, Clone, Copy)]
pub struct Source {
    /// Where it lies in the repository.
    pub path: &'static str,
    /// Its text.
    pub text: &'static str,
}

/// The [`Source`] of a file under `shaders/`.
macro_rules! source {
    ($path:literal) => {
        $crate::device::Source {
            path: concat!("shaders/", $path),
            text: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/shaders/", $path)),
        }
    };
}
pub(crate) use source;

/// A shader: the files that make it up. Its entry point has its name.
#[derive(Debug, Clone, Copy)]
pub struct Shader {
    /// The stem of its own file, and its entry point.
    pub name: &'static str,
    /// The structs it shares with the host.
    pub structs: &'static [Layout],
    /// Shared files first, its own last.
    pub sources: &'static [Source],
    /// The constants that every variant sets, each with the value used where a text is only checked.
    pub constants: Constants<'static>,
}

/// A field of a struct that host and shader share.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Its name on both sides.
    pub name: &'static str,
    /// Its place on the host, in bytes.
    pub offset: usize,
    /// Its type in the shader.
    pub wgsl: &'static str,
}

/// The host's layout of a shared struct.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// Its name on both sides.
    pub name: &'static str,
    /// Its size on the host, in bytes.
    pub size: usize,
    /// In order.
    pub fields: &'static [Field],
}

/// A host type with a counterpart in WGSL.
pub trait WgslType: bytemuck::Pod {
    /// The counterpart.
    const WGSL: &'static str;
}

macro_rules! wgsl_types {
    ($($host:ty => $wgsl:literal),* $(,)?) => {
        $(impl WgslType for $host { const WGSL: &'static str = $wgsl; })*
    };
}

wgsl_types! {
    u32 => "u32",
    i32 => "i32",
    f32 => "f32",
    [f32; 3] => "vec3f",
    [f32; 4] => "vec4f",
    [u32; 4] => "vec4u",
}

/// Declares a struct of plain data that a shader shares: `#[repr(C)]`, [`bytemuck::Pod`], and a `LAYOUT` for its [`Shader`].
/// A test compares every layout with what naga makes of the generated text.
macro_rules! shared_struct {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name { $($(#[$doc])* $vis $field: $type,)* }

        impl $name {
            /// The layout as the shader must see it.
            $vis const LAYOUT: $crate::device::Layout = $crate::device::Layout {
                name: stringify!($name),
                size: size_of::<$name>(),
                fields: &[$($crate::device::Field {
                    name: stringify!($field),
                    offset: std::mem::offset_of!($name, $field),
                    wgsl: <$type as $crate::device::WgslType>::WGSL,
                },)*],
            };
        }
    };
}
pub(crate) use shared_struct;

/// A shader's whole text, with the way back to its files.
#[derive(Debug, Clone)]
pub struct Assembled {
    /// The text that is compiled.
    pub text: String,
    /// The first line (from 1) of each part, and the part's path.
    parts: Vec<(u32, &'static str)>,
}

impl Shader {
    /// Joins the files behind the header of a variant.
    pub fn assemble(&self, constants: Constants<'_>) -> Assembled {
        let mut assembled = Assembled {
            text: String::new(),
            parts: Vec::new(),
        };
        assembled.append("generated header", &self.header(constants));
        for source in self.sources {
            assembled.append(source.path, source.text);
        }
        assembled
    }

    fn header(&self, constants: Constants<'_>) -> String {
        let mut header = format!("const WORKGROUP_SIZE: u32 = {WORKGROUP_SIZE}u;\n");
        for (name, value) in constants {
            let _ = writeln!(header, "const {name}: u32 = {value}u;");
        }
        for layout in self.structs {
            let fields: Vec<_> = layout
                .fields
                .iter()
                .map(|f| format!("{}: {}", f.name, f.wgsl))
                .collect();
            let _ = writeln!(header, "struct {} {{ {} }}", layout.name, fields.join(", "));
        }
        header
    }
}

impl Assembled {
    fn append(&mut self, path: &'static str, text: &str) {
        let line = self.text.lines().count() as u32 + 1;
        self.parts.push((line, path));
        self.text.push_str(text);
        if !text.ends_with('\n') {
            self.text.push('\n');
        }
    }

    /// The file and the line in it (from 1) of a line of the whole text.
    pub fn locate(&self, line: u32) -> (&'static str, u32) {
        let part = self.parts.partition_point(|p| p.0 <= line).max(1) - 1;
        let (first, path) = self.parts[part];
        (path, line.saturating_sub(first) + 1)
    }

    /// Parses and validates the text, with no optional capability, as every target must accept it. Needs no device.
    ///
    /// # Errors
    /// Where it is not valid WGSL: names the file and the line.
    pub fn validate(&self) -> Result<(naga::Module, naga::valid::ModuleInfo)> {
        let module = naga::front::wgsl::parse_str(&self.text)
            .map_err(|e| self.error(e.location(&self.text), e.message()))?;
        let info = naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::empty(),
        )
        .validate(&module)
        .map_err(|e| self.error(e.location(&self.text), &cause(e.as_inner())))?;
        Ok((module, info))
    }

    fn error(&self, location: Option<naga::SourceLocation>, problem: &str) -> Error {
        let place = location.map_or_else(String::new, |at| {
            let (path, line) = self.locate(at.line_number);
            format!("{path}:{line}:{}: ", at.line_position)
        });
        Error::device(
            format!("{place}{problem}"),
            "this is a fault of the program; run on the CPU and report it",
        )
    }
}

/// An error and its sources as one line.
fn cause(error: &dyn std::error::Error) -> String {
    std::iter::successors(error.source(), |e| e.source()).fold(error.to_string(), |text, source| {
        format!("{text}: {source}")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn shader(sources: &'static [Source]) -> Shader {
        Shader {
            name: "broken",
            structs: &[],
            sources,
            constants: &[],
        }
    }

    #[test]
    fn errors_name_the_file_and_its_own_line() {
        const PARSE: Shader = shader(&[
            Source {
                path: "shaders/shared/one.wgsl",
                text: "fn one() -> u32 {\n    return 1u;\n}",
            },
            Source {
                path: "shaders/broken.wgsl",
                text: "\n\nfn two() -> u32 { return nothing; }\n",
            },
        ]);
        let error = PARSE.assemble(&[]).validate().unwrap_err().to_string();
        assert!(error.starts_with("shaders/broken.wgsl:3:"), "{error}");

        const VALIDATE: Shader = shader(&[Source {
            path: "shaders/broken.wgsl",
            text: "fn one() {\n}\nfn two(x: f32) -> u32 {\n    return x;\n}\n",
        }]);
        let error = VALIDATE.assemble(&[]).validate().unwrap_err().to_string();
        assert!(error.starts_with("shaders/broken.wgsl:"), "{error}");
    }
}
