//! The reader: a tokenizer, and a walk through the prims that keeps the properties of the one mesh.

use super::super::{Draft, quoted};
use crate::error::Defect;
use glam::DVec3;
use std::collections::HashMap;
use std::str::FromStr;

const DAMAGED: &str = "the file is damaged: export it again";

/// Prims within prims; deeper nesting is no scene.
const MAX_DEPTH: usize = 64;

pub fn read(bytes: &[u8]) -> Result<Draft, Defect> {
    let text = std::str::from_utf8(bytes)
        .map_err(|_| Defect::new("start", "it is not text", "write the stage as .usda text"))?;
    let mut stage = Stage {
        tokens: tokenize(text)?,
        next: 0,
        mesh: None,
    };
    if stage.takes("(") {
        stage.skip_to(")")?;
    }
    while stage.next < stage.tokens.len() {
        stage.prim(0)?;
    }
    match stage.mesh {
        Some(mesh) => mesh.draft(),
        None => Err(Defect::new(
            "whole file",
            "there is no Mesh in it",
            "export the mesh itself, without references to other files",
        )),
    }
}

/// A word, a string with its first quote, or a bracket, and the line that it is on.
#[derive(Debug, Clone, Copy)]
struct Token<'a> {
    text: &'a str,
    line: usize,
}

impl Token<'_> {
    fn defect(&self, problem: impl Into<String>, remedy: &str) -> Defect {
        Defect::new(format!("line {}", self.line), problem, remedy)
    }

    fn is_string(&self) -> bool {
        self.text.starts_with(['"', '\''])
    }

    fn is_bracket(&self) -> bool {
        self.text.starts_with(is_bracket)
    }
}

/// Cuts the text into tokens; comments, commas and semicolons are space.
fn tokenize(text: &str) -> Result<Vec<Token<'_>>, Defect> {
    let mut tokens = Vec::new();
    let (mut rest, mut line) = (text, 1);
    while let Some(first) = rest.chars().next() {
        let length = match first {
            '#' => rest.find('\n').unwrap_or(rest.len()),
            '"' | '\'' => string_length(rest).ok_or_else(|| {
                Defect::new(format!("line {line}"), "a string does not end", DAMAGED)
            })?,
            _ if is_space(first) || is_bracket(first) => first.len_utf8(),
            _ => rest
                .find(|c| is_space(c) || is_bracket(c) || "\"'#".contains(c))
                .unwrap_or(rest.len()),
        };
        let (text, tail) = rest.split_at(length);
        if first != '#' && !is_space(first) {
            tokens.push(Token { text, line });
        }
        line += text.matches('\n').count();
        rest = tail;
    }
    Ok(tokens)
}

fn is_space(c: char) -> bool {
    c.is_whitespace() || c == ',' || c == ';'
}

fn is_bracket(c: char) -> bool {
    "()[]{}=".contains(c)
}

/// The bytes of the string that the text starts with: in one or three quotes, with a backslash before what does not end it.
fn string_length(text: &str) -> Option<usize> {
    let quote = &text[..1];
    let triple = quote.repeat(3);
    let end = if text.starts_with(&triple) {
        &triple
    } else {
        quote
    };
    let mut at = end.len();
    while !text[at..].starts_with(end) {
        let mut chars = text[at..].chars();
        let c = chars.next()?;
        at += c.len_utf8();
        if c == '\\' {
            at += chars.next()?.len_utf8();
        }
    }
    Some(at + end.len())
}

/// The tokens of a stage on the way through them.
struct Stage<'a> {
    tokens: Vec<Token<'a>>,
    next: usize,
    mesh: Option<Prim<'a>>,
}

impl<'a> Stage<'a> {
    fn take(&mut self) -> Result<Token<'a>, Defect> {
        let token = self.tokens.get(self.next).copied();
        self.next += 1;
        token.ok_or_else(|| {
            Defect::new(
                "end of file",
                "a bracket is not closed or a value is missing",
                "the file is truncated: export it again",
            )
        })
    }

    /// Takes the next token if it is this one.
    fn takes(&mut self, wanted: &str) -> bool {
        let next = self.tokens.get(self.next);
        let is = next.is_some_and(|token| token.text == wanted);
        self.next += usize::from(is);
        is
    }

    /// Passes over what an opening bracket began, to its end.
    fn skip_to(&mut self, close: &'static str) -> Result<(), Defect> {
        let mut open = vec![close];
        while let Some(&wanted) = open.last() {
            let token = self.take()?;
            match token.text {
                "(" => open.push(")"),
                "[" => open.push("]"),
                "{" => open.push("}"),
                ")" | "]" | "}" if token.text != wanted => {
                    let problem = format!("{} where {wanted} was expected", token.text);
                    return Err(token.defect(problem, DAMAGED));
                }
                ")" | "]" | "}" => drop(open.pop()),
                _ => {}
            }
        }
        Ok(())
    }

    /// `def Type "name" (metadata) { properties and prims }`.
    fn prim(&mut self, depth: usize) -> Result<(), Defect> {
        let start = self.take()?;
        if start.text != "def" || depth > MAX_DEPTH {
            let problem = format!("{} is not read here", quoted(start.text));
            return Err(start.defect(problem, "export the mesh alone, or flatten the stage"));
        }
        let kind = self.take()?;
        if !kind.is_string() {
            self.take()?;
        }
        if self.takes("(") {
            self.skip_to(")")?;
        }
        let open = self.take()?;
        if open.text != "{" {
            return Err(open.defect(format!("{} instead of {{", quoted(open.text)), DAMAGED));
        }
        let had_mesh = self.mesh.is_some();
        let mut prim = Prim::default();
        while !self.takes("}") {
            match self.tokens.get(self.next).map(|token| token.text) {
                Some("def" | "over" | "class") => self.prim(depth + 1)?,
                _ => self.property(&mut prim)?,
            }
        }
        let is_mesh = kind.text == "Mesh";
        if is_mesh && self.mesh.is_some() {
            return Err(start.defect("there is a second mesh", "export one mesh alone"));
        }
        if is_mesh || self.mesh.is_some() != had_mesh {
            prim.check_transformation(is_mesh)?;
        }
        if is_mesh {
            self.mesh = Some(prim);
        }
        Ok(())
    }

    /// `uniform type[] name = value (metadata)`, where a relationship has no type.
    fn property(&mut self, prim: &mut Prim<'a>) -> Result<(), Defect> {
        let mut name = self.take()?;
        while let "custom" | "uniform" | "varying" | "prepend" | "append" | "add" | "delete" =
            name.text
        {
            name = self.take()?;
        }
        if name.text != "rel" && self.takes("[") {
            self.skip_to("]")?;
        }
        name = self.take()?;
        if name.is_bracket() || name.is_string() {
            let problem = format!("{} is no property", quoted(name.text));
            return Err(name.defect(problem, "export the mesh without variants"));
        }
        if self.takes("=") {
            let begin = self.next;
            match self.take()?.text {
                "(" => self.skip_to(")")?,
                "[" => self.skip_to("]")?,
                "{" => self.skip_to("}")?,
                _ => {}
            }
            let value = self.tokens[begin..self.next].to_vec();
            prim.properties.insert(name.text, value);
        }
        if self.takes("(") {
            self.skip_to(")")?;
        }
        Ok(())
    }
}

/// The values of a prim's properties by name.
#[derive(Default)]
struct Prim<'a> {
    properties: HashMap<&'a str, Vec<Token<'a>>>,
}

impl<'a> Prim<'a> {
    /// What is inside the brackets of a value; nothing where there is no such property.
    fn items(&self, name: &str) -> impl Iterator<Item = Token<'a>> {
        let value = self.properties.get(name);
        let tokens = value.map_or(&[][..], Vec::as_slice).iter().copied();
        tokens.filter(|token| !token.is_bracket())
    }

    fn numbers<T: FromStr>(&self, name: &str) -> Result<Vec<T>, Defect> {
        let number = |token: Token<'a>| {
            token.text.parse().map_err(|_| {
                let problem = format!("{} in {name} is not its number", quoted(token.text));
                token.defect(problem, DAMAGED)
            })
        };
        self.items(name).map(number).collect()
    }

    /// The first word of a value, without quotes.
    fn word(&self, name: &str) -> Option<&'a str> {
        let first = self.items(name).next()?;
        Some(first.text.trim_matches(['"', '\'']))
    }

    /// Refuses transformations but the translation of a mesh.
    fn check_transformation(&self, is_mesh: bool) -> Result<(), Defect> {
        for token in self.items("xformOpOrder") {
            if !is_mesh || token.text != "\"xformOp:translate\"" {
                return Err(token.defect(
                    format!("the mesh is transformed by {}", quoted(token.text)),
                    "apply the transformation before the export",
                ));
            }
        }
        Ok(())
    }

    /// Refuses what would make another surface.
    fn check_supported(&self) -> Result<(), Defect> {
        let refuse = |problem: &str, remedy: &str| Err(Defect::new("mesh", problem, remedy));
        let mut names = self.properties.keys();
        if names.any(|name| name.ends_with(".timeSamples") && !name.starts_with("primvars:")) {
            return refuse("it is animated", "export a single frame");
        }
        if self.items("holeIndices").next().is_some() {
            return refuse("it has faces that are holes", "delete those faces");
        }
        match self.word("interpolateBoundary") {
            None | Some("edgeAndCorner") => Ok(()),
            _ => refuse(
                "its boundary is not interpolated by edgeAndCorner",
                "set interpolateBoundary to edgeAndCorner",
            ),
        }
    }

    fn draft(&self) -> Result<Draft, Defect> {
        self.check_supported()?;
        let coordinates = self.numbers::<f64>("points")?;
        let (points, rest) = coordinates.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(Defect::new("points", "a coordinate is missing", DAMAGED));
        }
        let translation = match self.numbers("xformOp:translate")?[..] {
            [x, y, z] if self.word("xformOpOrder").is_some() => DVec3::new(x, y, z),
            _ => DVec3::ZERO,
        };
        let positions = points.iter().map(|&p| DVec3::from_array(p) + translation);
        let mut draft = Draft::new(positions.collect());
        self.faces(&mut draft)?;
        self.creases(&mut draft)?;
        let corners = self.numbers("cornerIndices")?;
        let sharpness = self.numbers("cornerSharpnesses")?;
        if corners.len() != sharpness.len() {
            return Err(unequal("cornerIndices", "cornerSharpnesses"));
        }
        for (&corner, &sharpness) in corners.iter().zip(&sharpness) {
            draft.push_corner(corner, sharpness, || "cornerIndices".into())?;
        }
        Ok(draft)
    }

    fn faces(&self, draft: &mut Draft) -> Result<(), Defect> {
        let counts = self.numbers("faceVertexCounts")?;
        let indices = self.numbers("faceVertexIndices")?;
        let is_left_handed = self.word("orientation") == Some("leftHanded");
        let mut rest = indices.as_slice();
        for (f, &count) in counts.iter().enumerate() {
            let Some(corners) = rest.split_off(..count) else {
                return Err(unequal("faceVertexCounts", "faceVertexIndices"));
            };
            let mut face = corners.to_vec();
            if is_left_handed {
                face.reverse();
            }
            draft.push_face(&face, || format!("face {f}"))?;
        }
        match rest {
            [] => Ok(()),
            _ => Err(unequal("faceVertexCounts", "faceVertexIndices")),
        }
    }

    /// Chains of edges, with a sharpness for each chain or for each edge.
    fn creases(&self, draft: &mut Draft) -> Result<(), Defect> {
        let indices = self.numbers("creaseIndices")?;
        let lengths = self.numbers("creaseLengths")?;
        let sharpness = self.numbers("creaseSharpnesses")?;
        let mut edges = Vec::new();
        let mut rest = indices.as_slice();
        for (chain, &length) in lengths.iter().enumerate() {
            let Some(vertices) = rest.split_off(..length) else {
                return Err(unequal("creaseLengths", "creaseIndices"));
            };
            edges.extend(vertices.windows(2).map(|w| (chain, [w[0], w[1]])));
        }
        let by_chain = sharpness.len() == lengths.len();
        if !rest.is_empty() || !(by_chain || sharpness.len() == edges.len()) {
            return Err(unequal("creaseLengths", "creaseSharpnesses"));
        }
        for (e, &(chain, edge)) in edges.iter().enumerate() {
            let sharpness = sharpness[if by_chain { chain } else { e }];
            draft.push_crease(edge, sharpness, || "creaseIndices".into())?;
        }
        Ok(())
    }
}

fn unequal(a: &str, b: &str) -> Defect {
    Defect::new("mesh", format!("{a} and {b} do not agree"), DAMAGED)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]\n";

    fn mesh(properties: &str) -> String {
        format!("def Mesh \"m\"\n{{\n{SQUARE}{properties}\n}}\n")
    }

    fn refusal(text: &str) -> Defect {
        read(text.as_bytes()).err().unwrap()
    }

    #[test]
    fn other_programs_layouts_are_read() {
        let before = r##"#usda 1.0
            (
                doc = """two
                lines )"""
            )
            # by hand
            def Xform "root" (
                kind = "component" # ) in a comment
            )
            {
                custom string note = "} not the \"end\"" ( doc = 'it } is' )
                def Scope "nothing" {}
            "##;
        let properties = r##"uniform token orientation = "leftHanded"
            rel material:binding = </Looks/a>
            float unset
            int[] creaseIndices = [0, 1, 2, 3, 0]
            int[] creaseLengths = [3, 2]
            float[] creaseSharpnesses = [1, 2, inf]
            texCoord2f[] primvars:st = [(0, 0)] ( interpolation = "faceVarying" )"##;
        let draft = read(format!("{before}{}}}", mesh(properties)).as_bytes()).unwrap();
        assert_eq!(draft.mesh.face(0), [3, 2, 1, 0]);
        let creases = draft.creases.iter().map(|c| (c.edge, c.sharpness));
        let expected = [([0, 1], 1.0), ([1, 2], 2.0), ([3, 0], f64::INFINITY)];
        assert!(creases.eq(expected));
    }

    #[test]
    fn what_would_be_another_surface_is_refused() {
        for (properties, problem) in [
            ("token[] xformOpOrder = [\"xformOp:scale\"]", "transformed"),
            ("int[] holeIndices = [0]", "holes"),
            (
                "point3f[] points.timeSamples = { 0: [(0, 0, 0)] }",
                "animated",
            ),
            ("token interpolateBoundary = \"none\"", "boundary"),
            (
                "int[] cornerIndices = [0]\nfloat[] cornerSharpnesses = [2.5]",
                "semi-sharp",
            ),
            ("variantSet \"look\" = { \"a\" { } }", "property"),
            ("def Mesh \"second\" { }", "second mesh"),
        ] {
            let defect = refusal(&mesh(properties));
            assert!(defect.problem.contains(problem), "{properties}: {defect:?}");
        }
        let moved = "token[] xformOpOrder = [\"xformOp:translate\"]";
        let nested = format!("def Xform \"x\" {{ {} {moved} }}", mesh(""));
        assert!(refusal(&nested).problem.contains("transformed"));
        assert!(refusal("def Scope \"a\" {}").problem.contains("no Mesh"));
    }

    #[test]
    fn damage_is_an_error() {
        let whole = mesh("int[] cornerIndices = [1]\nfloat[] cornerSharpnesses = [10]");
        let whole = format!("#usda 1.0\n(\n)\n{}", whole.trim_end());
        assert_eq!(read(whole.as_bytes()).unwrap().sharp_corners, [1]);
        for end in 0..whole.len() {
            assert!(read(&whole.as_bytes()[..end]).is_err(), "{end}");
        }
        for (from, to) in [
            ("[4]", "[5]"),
            ("[4]", "[3]"),
            ("[4]", "[-1]"),
            ("[4]", "[99999999999999999999]"),
            ("2, 3]", "2, 4]"),
            ("2, 3]", "2, x]"),
            ("(0, 1, 0)]", "(0, 1)]"),
            ("[1]", "[-1]"),
            ("[1]", "[4]"),
            ("[10]", "[10, 10]"),
            ("[10]", "[nan]"),
            ("(\n)", "((\n)"),
        ] {
            let damaged = whole.replace(from, to);
            assert!(read(damaged.as_bytes()).is_err(), "{from} → {to}");
        }
        let deep = "def Xform \"a\" { ".repeat(100_000);
        assert!(read(deep.as_bytes()).is_err());
    }
}
