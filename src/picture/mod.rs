//! Pictures of surfaces, drawn in software: the same on every machine with no display, driver or GPU.
//!
//! **Theory.** A [`Camera`] looks in perspective and frames what it is given. Triangles and strokes go through a depth buffer with several samples
//! a pixel; light is reckoned in linear terms; normals and values are interpolated with the perspective. Values
//! become colours through a map whose lightness falls evenly ([`color`]), so that a picture says the same in grey.
//!
//! **Practice.** The picture is cut into tiles, each drawn by one thread from its own list of triangles in the order given: the bits do not depend on
//! the number of threads. Letters are strokes too, from a small alphabet of our own (`lettering`).

mod camera;
pub mod color;
mod legend;
mod lettering;
mod raster;
mod scale;
mod shape;

pub use camera::{Axis, Camera, View};
pub use color::Rgb;
pub use legend::Legend;
pub use scale::Scale;
pub use shape::{Shape, edges};

use crate::error::{Error, Result};
use crate::files::write_whole;
use crate::mesh::PolygonMesh;
use glam::{DVec2, DVec3};
use std::path::Path;

/// Most pixels along a side.
pub const LARGEST_SIDE: u32 = 16_384;
/// Between what is shown and the border, against the shorter side.
const MARGIN: f64 = 0.06;

/// What a picture shows, on white.
#[derive(Default)]
pub struct Scene<'a> {
    /// Surfaces and their colours.
    pub surfaces: Vec<(&'a Shape, Paint<'a>)>,
    /// Lines and points over them.
    pub strokes: Vec<Strokes>,
    /// What the colours mean.
    pub legend: Option<Legend>,
}

/// The colour of a surface.
#[derive(Debug, Clone, Copy)]
pub enum Paint<'a> {
    /// One colour.
    Plain(Rgb),
    /// `[vertices of the mesh]`: shares of the colour map, cut off at 1; grey where negative, for what is not known.
    Values(&'a [f64]),
}

/// Lines of one colour and width with round ends, hidden by the surfaces in front of them; a line of no length is a point.
pub struct Strokes {
    /// `[lines, 2]`: their ends.
    pub segments: Vec<[DVec3; 2]>,
    /// Their colour.
    pub color: Rgb,
    /// Their width in pixels.
    pub width: f64,
}

impl Strokes {
    /// The edges of a mesh.
    pub fn edges(mesh: &PolygonMesh, width: f64) -> Self {
        let ends = |edge: [u32; 2]| edge.map(|v| mesh.positions[v as usize]);
        Self {
            segments: edges(mesh).into_iter().map(ends).collect(),
            color: color::INK,
            width,
        }
    }
}

/// Rows of pixels from the top, in sRGB.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
}

impl Picture {
    /// Draws a scene; `size` is width and height in pixels, each from 1 to [`LARGEST_SIDE`].
    pub fn draw(scene: &Scene<'_>, view: &View, size: [u32; 2]) -> Self {
        let [width, height] = size.map(|n| n.clamp(1, LARGEST_SIDE) as usize);
        let size = DVec2::new(width as f64, height as f64);
        let margin = DVec2::splat(MARGIN * size.min_element());
        let room = scene.legend.as_ref().map_or(0.0, |l| l.width(size));
        let high = (size - margin - DVec2::X * room).max(margin + 1.0);
        let camera = Camera::framing(view, scene.points(), [margin, high]);
        let mut picture = Self {
            width,
            height,
            pixels: raster::draw(scene, &camera, [width, height]),
        };
        if let Some(legend) = &scene.legend {
            legend.draw(&mut picture);
        }
        picture
    }

    /// Width and height in pixels.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// `[height × width]`, row by row from the top.
    pub fn pixels(&self) -> &[Rgb] {
        &self.pixels
    }

    /// The picture as a PNG file.
    ///
    /// # Errors
    /// None in practice: there are as many pixels as the size says.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encode = || {
            let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_depth(png::BitDepth::Eight);
            encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
            let mut writer = encoder.write_header()?;
            writer.write_image_data(self.pixels.as_flattened())?;
            writer.finish()
        };
        encode()
            .map_err(|e| Error::input(format!("the picture: {e}"), "report this as a defect"))?;
        Ok(bytes)
    }

    /// Writes it as a PNG file, whole or not at all.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let bytes = self.png()?;
        write_whole(path, |out| out.write_all(&bytes))
    }

    /// Lays a colour over a pixel; those outside are passed over.
    fn blend(&mut self, x: i64, y: i64, color: Rgb, cover: f64) {
        let inside = |at: i64, size: usize| usize::try_from(at).ok().filter(|&at| at < size);
        if let (Some(x), Some(y)) = (inside(x, self.width), inside(y, self.height)) {
            let pixel = &mut self.pixels[y * self.width + x];
            *pixel = color::mixed(*pixel, color, cover);
        }
    }
}

impl Scene<'_> {
    /// Everything that should be in the picture.
    fn points(&self) -> impl Iterator<Item = DVec3> + Clone {
        let surfaces = self.surfaces.iter();
        let surfaces = surfaces.flat_map(|(shape, _)| shape.positions.iter().copied());
        let strokes = self.strokes.iter().flat_map(|s| s.segments.as_flattened());
        surfaces.chain(strokes.copied())
    }
}
