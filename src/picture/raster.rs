//! Triangles and strokes through a depth buffer, tile by tile.

use super::camera::Camera;
use super::color::{self, Rgb};
use super::{Paint, Scene, Shape, Strokes};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

/// Samples along each side of a pixel.
const SAMPLES: usize = 4;
/// Pixels along each side of a tile.
const TILE: usize = 32;
/// Samples along each side of a tile.
const SIDE: usize = TILE * SAMPLES;
/// How much nearer strokes count than they are: edges lie in the faces that they bound.
const LIFT: f64 = 1.001;
/// Share of a point's colour that is left at the far end of a scene without surfaces; the rest is white, since nothing else shows the depth of a cloud.
const FAR: f64 = 0.3;
/// Covers the rounding of barycentric weights, so that no sample falls between two triangles.
const SLACK: f64 = -1e-9;

const WHITE: [f32; 3] = [1.0; 3];
/// Against the colour of the front, where a surface is seen from behind.
const BEHIND: [f32; 3] = [0.62, 0.55, 0.5];

/// The pixels of a scene, row by row from the top.
pub(super) fn draw(scene: &Scene<'_>, camera: &Camera, [width, height]: [usize; 2]) -> Vec<Rgb> {
    let surfaces: Vec<_> = scene
        .surfaces
        .iter()
        .map(|(shape, paint)| SeenSurface::new(shape, *paint, camera))
        .collect();
    let far = if scene.surfaces.is_empty() { FAR } else { 1.0 };
    let strokes: Vec<_> = scene
        .strokes
        .iter()
        .map(|strokes| SeenStrokes::new(strokes, camera, far))
        .collect();
    let bins = Bins::new(&surfaces, &strokes, [width, height]);
    let mut pixels = vec![[255; 3]; width * height];
    pixels
        .par_chunks_mut(TILE * width)
        .enumerate()
        .for_each(|(row, pixels)| {
            let mut tile = Tile::default();
            for column in 0..width.div_ceil(TILE) {
                let items = bins.items([column, row]);
                if items.is_empty() {
                    continue;
                }
                tile.clear([column * TILE, row * TILE]);
                for &(layer, index) in items {
                    let layer = layer as usize;
                    match surfaces.get(layer) {
                        Some(surface) => tile.triangle(surface, index as usize),
                        None => tile.stroke(&strokes[layer - surfaces.len()], index as usize),
                    }
                }
                tile.average_into(pixels, width);
            }
        });
    pixels
}

/// A surface in the picture.
struct SeenSurface<'a> {
    shape: &'a Shape,
    paint: Paint<'a>,
    /// `[vertices]`: pixels and nearness ([`Camera::project`]).
    points: Vec<DVec3>,
    /// `[vertices]`: right, up and towards the eye.
    normals: Vec<Vec3>,
}

impl<'a> SeenSurface<'a> {
    fn new(shape: &'a Shape, paint: Paint<'a>, camera: &Camera) -> Self {
        let points = shape.positions.par_iter().map(|&p| camera.project(p));
        let normals = shape.normals.par_iter();
        Self {
            shape,
            paint,
            points: points.collect(),
            normals: normals.map(|&n| camera.direction(n).as_vec3()).collect(),
        }
    }

    fn corners(&self, t: usize) -> [DVec3; 3] {
        self.shape.triangles[t].map(|v| self.points[v as usize])
    }

    /// The colour in linear light at some weights of a triangle's corners.
    fn light(&self, t: usize, weights: [f64; 3], front: bool) -> [f32; 3] {
        let corners = self.shape.triangles[t].map(|v| v as usize);
        let weighted = |k: usize| self.normals[corners[k]] * weights[k] as f32;
        let normal = (weighted(0) + weighted(1) + weighted(2)).normalize_or(Vec3::Z);
        let color = match self.paint {
            Paint::Plain(color) => color::linear(color),
            Paint::Values(values) => {
                let value = |k: usize| weights[k] * values[self.shape.sources[corners[k]] as usize];
                match value(0) + value(1) + value(2) {
                    unknown if unknown < 0.0 => color::linear(color::UNKNOWN),
                    value => color::linear_map(value),
                }
            }
        };
        match front {
            true => lit(color, normal),
            false => lit(std::array::from_fn(|k| color[k] * BEHIND[k]), -normal),
        }
    }
}

/// A colour under the light of the scene: the sky, a lamp from the upper left behind the eye, and a little gloss. The page's view has the same
/// (`view.js`).
fn lit(color: [f32; 3], normal: Vec3) -> [f32; 3] {
    let lamp = Vec3::new(-0.35, 0.55, 0.758);
    let halfway = Vec3::new(-0.187, 0.293, 0.938);
    let diffuse = 0.15 + 0.1 * (1.0 + normal.y) + 0.7 * normal.dot(lamp).max(0.0);
    let gloss = 0.06 * normal.dot(halfway).max(0.0).powi(32);
    color.map(|x| x * diffuse + gloss)
}

/// Strokes in the picture.
struct SeenStrokes {
    /// `[lines, 2]`: pixels and nearness.
    segments: Vec<[DVec3; 2]>,
    color: [f32; 3],
    radius: f64,
    /// The share of the colour that is left of points at the far end.
    far: f64,
}

impl SeenStrokes {
    fn new(strokes: &Strokes, camera: &Camera, far: f64) -> Self {
        let segments = strokes.segments.par_iter();
        Self {
            segments: segments
                .map(|ends| ends.map(|p| camera.project(p)))
                .collect(),
            color: color::linear(strokes.color),
            radius: 0.5 * strokes.width,
            far,
        }
    }
}

/// What there is to draw in each tile: layer (surfaces first, then strokes) and number, in the order of the scene.
struct Bins {
    columns: usize,
    offsets: Vec<usize>,
    items: Vec<(u32, u32)>,
}

impl Bins {
    fn new(surfaces: &[SeenSurface<'_>], strokes: &[SeenStrokes], size: [usize; 2]) -> Self {
        let [columns, rows] = size.map(|n| n.div_ceil(TILE));
        let tiles = |points: &[DVec3], reach: f64| {
            let outside = (DVec2::INFINITY, DVec2::NEG_INFINITY);
            let grow =
                |(lo, hi): (DVec2, DVec2), p: &DVec3| (lo.min(p.truncate()), hi.max(p.truncate()));
            let (lo, hi) = points.iter().fold(outside, grow);
            let tile = |x: f64, count: usize| ((x / TILE as f64).max(0.0) as usize).min(count - 1);
            let (lo, hi) = (lo - reach, hi + reach);
            let across = tile(lo.x, columns)..=tile(hi.x, columns);
            (tile(lo.y, rows)..=tile(hi.y, rows))
                .flat_map(move |row| across.clone().map(move |column| row * columns + column))
        };
        let for_each = |visit: &mut dyn FnMut(usize, (u32, u32))| {
            for (layer, surface) in surfaces.iter().enumerate() {
                for t in 0..surface.shape.triangles.len() {
                    tiles(&surface.corners(t), 0.0)
                        .for_each(|tile| visit(tile, (layer as u32, t as u32)));
                }
            }
            for (layer, strokes) in strokes.iter().enumerate() {
                let layer = (surfaces.len() + layer) as u32;
                for (s, segment) in strokes.segments.iter().enumerate() {
                    tiles(segment, strokes.radius).for_each(|tile| visit(tile, (layer, s as u32)));
                }
            }
        };
        let mut offsets = vec![0; columns * rows + 1];
        for_each(&mut |tile, _| offsets[tile + 1] += 1);
        for tile in 1..offsets.len() {
            offsets[tile] += offsets[tile - 1];
        }
        let mut free = offsets.clone();
        let mut items = vec![(0, 0); offsets[columns * rows]];
        for_each(&mut |tile, item| {
            items[free[tile]] = item;
            free[tile] += 1;
        });
        Self {
            columns,
            offsets,
            items,
        }
    }

    fn items(&self, [column, row]: [usize; 2]) -> &[(u32, u32)] {
        let tile = row * self.columns + column;
        &self.items[self.offsets[tile]..self.offsets[tile + 1]]
    }
}

/// A tile being drawn.
struct Tile {
    /// The pixel in its upper left corner.
    origin: [usize; 2],
    /// `[SIDE²]`: of the nearest so far, 0 for the background.
    nearness: Vec<f32>,
    /// `[SIDE²]`: linear.
    light: Vec<[f32; 3]>,
}

impl Default for Tile {
    fn default() -> Self {
        Self {
            origin: [0; 2],
            nearness: vec![0.0; SIDE * SIDE],
            light: vec![WHITE; SIDE * SIDE],
        }
    }
}

impl Tile {
    fn clear(&mut self, origin: [usize; 2]) {
        self.origin = origin;
        self.nearness.fill(0.0);
        self.light.fill(WHITE);
    }

    /// Asks for nearness at every sample in a rectangle, and where that is nearer than all before, for the colour.
    fn cover<S>(
        &mut self,
        [low, high]: [DVec2; 2],
        touch: impl Fn(DVec2) -> Option<(f64, S)>,
        light: impl Fn(f64, S) -> [f32; 3],
    ) {
        let origin = DVec2::new(self.origin[0] as f64, self.origin[1] as f64);
        let sample = |p: DVec2| (p - origin) * SAMPLES as f64 - 0.5;
        let last = (SIDE - 1) as f64;
        let (low, high) = (
            sample(low).ceil().max(DVec2::ZERO),
            sample(high).floor().min(DVec2::splat(last)),
        );
        if low.x > high.x || low.y > high.y {
            return;
        }
        for j in low.y as usize..=high.y as usize {
            for i in low.x as usize..=high.x as usize {
                let at = origin + (DVec2::new(i as f64, j as f64) + 0.5) / SAMPLES as f64;
                let Some((nearness, state)) = touch(at) else {
                    continue;
                };
                let place = j * SIDE + i;
                if nearness as f32 > self.nearness[place] {
                    self.nearness[place] = nearness as f32;
                    self.light[place] = light(nearness, state);
                }
            }
        }
    }

    fn triangle(&mut self, surface: &SeenSurface<'_>, t: usize) {
        let corners = surface.corners(t);
        let [a, b, c] = corners.map(DVec3::truncate);
        let area = (b - a).perp_dot(c - a);
        if area.abs() < f64::MIN_POSITIVE {
            return;
        }
        // Counter-clockwise seen from outside is clockwise where y points downwards.
        let front = area < 0.0;
        let per_area = area.recip();
        let touch = |p: DVec2| {
            let u = (c - b).perp_dot(p - b) * per_area;
            let v = (a - c).perp_dot(p - c) * per_area;
            let w = 1.0 - u - v;
            // Weights in the picture times nearness are those on the surface, but for their sum.
            let flat = [u * corners[0].z, v * corners[1].z, w * corners[2].z];
            (u.min(v).min(w) >= SLACK).then(|| (flat[0] + flat[1] + flat[2], flat))
        };
        let bounds = [a.min(b).min(c), a.max(b).max(c)];
        self.cover(bounds, touch, |nearness, flat| {
            surface.light(t, flat.map(|x| x / nearness), front)
        });
    }

    fn stroke(&mut self, strokes: &SeenStrokes, s: usize) {
        let [a, b] = strokes.segments[s];
        let (p, along) = (a.truncate(), (b - a).truncate());
        let length_squared = along.length_squared();
        let touch = |at: DVec2| {
            let share = match length_squared > 0.0 {
                true => ((at - p).dot(along) / length_squared).clamp(0.0, 1.0),
                false => 0.0,
            };
            let near = at.distance_squared(p + share * along) <= strokes.radius * strokes.radius;
            near.then_some((LIFT * (a.z + share * (b.z - a.z)), ()))
        };
        let (q, reach) = (b.truncate(), DVec2::splat(strokes.radius));
        self.cover(
            [p.min(q) - reach, p.max(q) + reach],
            touch,
            |nearness, ()| {
                let share = match length_squared > 0.0 {
                    true => 1.0,
                    false => strokes.far + (1.0 - strokes.far) * Camera::depth_share(nearness),
                };
                strokes.color.map(|x| 1.0 + share as f32 * (x - 1.0))
            },
        );
    }

    /// Writes the tile into its rows of pixels. Means are of square roots, about as the eye sees: dark lines averaged in linear light look beaded.
    fn average_into(&self, rows: &mut [Rgb], width: usize) {
        let left = self.origin[0];
        for (y, row) in rows.chunks_mut(width).enumerate() {
            let right = width.min(left + TILE);
            for (x, pixel) in row[left..right].iter_mut().enumerate() {
                let mut sum = [0.0; 3];
                for j in y * SAMPLES..(y + 1) * SAMPLES {
                    let first = j * SIDE + x * SAMPLES;
                    for light in &self.light[first..first + SAMPLES] {
                        sum = std::array::from_fn(|k| sum[k] + light[k].min(1.0).sqrt());
                    }
                }
                *pixel = color::encoded(sum.map(|x| (x / (SAMPLES * SAMPLES) as f32).powi(2)));
            }
        }
    }
}
