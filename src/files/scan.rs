//! Targets: a surface or a cloud of points, from one file or from several as one.

use super::{Surface, draft, poses, surface, xyz};
use crate::error::{Defect, Error, Result};
use crate::mesh::check::{self, Census};
use crate::mesh::{PointCloud, PolygonMesh};
use glam::DVec3;
use poses::Pose;
use std::path::{Path, PathBuf};

/// What a surface can be fitted to.
#[derive(Debug, Clone, PartialEq)]
pub enum Scan {
    /// Faces.
    Surface(Surface),
    /// Points without faces; there is at least one, and their bounding box has an extent.
    Points(PointCloud),
}

/// Reads a surface or, from a PLY file without faces and from XYZ (a line `x y z …` to a point), a cloud of points; of several files, all
/// of them as one.
///
/// A file `.conf` gives poses to the files of the names in it (a line `bmesh FILE tx ty tz qx qy qz qw` to a scan, as in Stanford's
/// repository). Without other files beside it, it stands for all those that are in its folder. Surfaces together stay a surface; with a
/// cloud among them all become points. The points of PLY files with a range grid are joined to a surface, unless they jump in depth.
///
/// # Errors
/// As [`super::read_surface`], but for points without faces; where a file has no pose though there are poses, or none of a `.conf` is there.
pub fn read_scans(paths: &[PathBuf]) -> Result<Scan> {
    let is_poses = |path: &&PathBuf| has_extension(path, "conf");
    let mut posed = Vec::new();
    for conf in paths.iter().filter(is_poses) {
        posed.extend(read_poses(conf)?.into_iter().map(|pose| (conf, pose)));
    }
    let mut scans = Vec::new();
    for path in paths.iter().filter(|path| !is_poses(path)) {
        let scan = read_scan(path)?;
        let pose = pose_of(path, posed.iter().map(|(_, pose)| pose));
        if !posed.is_empty() && pose.is_none() {
            return Err(Error::file(
                path,
                "name",
                "it has no pose in the .conf",
                "add one",
            ));
        }
        scans.push((scan, pose));
    }
    if scans.is_empty() {
        let there = |(conf, pose): &&(&PathBuf, Pose)| conf.with_file_name(&pose.file).exists();
        let (found, absent): (Vec<_>, Vec<_>) = posed.iter().partition(there);
        for (conf, pose) in &found {
            scans.push((read_scan(&conf.with_file_name(&pose.file))?, Some(pose)));
        }
        if !(found.is_empty() || absent.is_empty()) {
            let names: Vec<&str> = absent.iter().map(|(_, pose)| pose.file.as_str()).collect();
            log::warn!("left out, because they are not there: {}", names.join(", "));
        }
    }
    match (&scans[..], paths) {
        ([], [conf, ..]) => Err(Error::file(
            conf,
            "files",
            "none of them is there",
            "put them into its folder",
        )),
        ([], []) => Err(Error::input("there is no file to read", "name one")),
        ([(_, None)], _) => Ok(scans.swap_remove(0).0),
        _ => Ok(joined(scans)?),
    }
}

fn has_extension(path: &Path, name: &str) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(name))
}

fn read_poses(path: &Path) -> Result<Vec<Pose>> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    poses::read(&bytes).map_err(|defect| defect.in_file(path))
}

fn pose_of<'a>(path: &Path, mut poses: impl Iterator<Item = &'a Pose>) -> Option<&'a Pose> {
    poses.find(|pose| Path::new(&pose.file).file_name() == path.file_name())
}

fn read_scan(path: &Path) -> Result<Scan> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    scan(path, &bytes).map_err(|defect| defect.in_file(path))
}

fn scan(path: &Path, bytes: &[u8]) -> Result<Scan, Defect> {
    let cloud = if has_extension(path, "xyz") {
        xyz::read(bytes)?
    } else {
        let draft = draft(path, bytes)?;
        if !has_extension(path, "ply") || draft.mesh.face_count() + draft.short_faces > 0 {
            return surface(draft).map(Scan::Surface);
        }
        PointCloud {
            positions: draft.mesh.positions,
            normals: draft.normals,
            confidence: draft.confidence,
        }
    };
    check::sound_points(&cloud.positions)?;
    Ok(Scan::Points(cloud))
}

/// All scans in one frame.
fn joined(scans: Vec<(Scan, Option<&Pose>)>) -> Result<Scan, Defect> {
    let with_faces = scans
        .iter()
        .all(|(scan, _)| matches!(scan, Scan::Surface(_)));
    let mut mesh = PolygonMesh::default();
    let mut confidence = Vec::new();
    let mut cloud = PointCloud::default();
    for (scan, pose) in scans {
        let place = |p: &DVec3| pose.map_or(*p, |pose| pose.point(*p));
        match scan {
            Scan::Surface(surface) if with_faces => {
                join_weights(
                    &mut confidence,
                    mesh.positions.len(),
                    &surface.confidence,
                    surface.mesh.positions.len(),
                );
                append(&mut mesh, &surface.mesh, place)?;
            }
            other => {
                let points = points_of(other);
                join_weights(
                    &mut cloud.confidence,
                    cloud.positions.len(),
                    &points.confidence,
                    points.positions.len(),
                );
                // Normals are of use only where all points have one.
                if cloud.normals.len() == cloud.positions.len() {
                    let turn = |n: &DVec3| pose.map_or(*n, |pose| pose.direction(*n));
                    cloud.normals.extend(points.normals.iter().map(turn));
                }
                cloud.positions.extend(points.positions.iter().map(place));
            }
        }
    }
    if with_faces {
        check::sound(&mesh)?;
        let census = Census::of(&mesh);
        return Ok(Scan::Surface(Surface {
            mesh,
            census,
            confidence,
        }));
    }
    if cloud.normals.len() != cloud.positions.len() {
        cloud.normals.clear();
    }
    check::sound_points(&cloud.positions)?;
    Ok(Scan::Points(cloud))
}

/// Appends the weights of `added` vertices to those of `present` ones; files without weights count as 1.
fn join_weights(all: &mut Vec<f64>, present: usize, weights: &[f64], added: usize) {
    if !(all.is_empty() && weights.is_empty()) {
        all.resize(present, 1.0);
        all.extend(weights);
        all.resize(present + added, 1.0);
    }
}

fn append(
    mesh: &mut PolygonMesh,
    other: &PolygonMesh,
    place: impl Fn(&DVec3) -> DVec3,
) -> Result<(), Defect> {
    let start = mesh.positions.len();
    let corners = mesh.corners().len() + other.corners().len();
    if start + other.positions.len() > u32::MAX as usize || corners > u32::MAX as usize {
        return Err(Defect::new(
            "files",
            "together they have more than 4,294,967,295 vertices or corners",
            "give fewer, or decimate them",
        ));
    }
    mesh.positions.extend(other.positions.iter().map(place));
    let mut face = Vec::new();
    for corners in other.faces() {
        face.clear();
        face.extend(corners.iter().map(|v| v + start as u32));
        mesh.push_face(&face);
    }
    Ok(())
}

/// The points of a scan: the vertices of its faces, if it has any.
fn points_of(scan: Scan) -> PointCloud {
    let surface = match scan {
        Scan::Points(points) => return points,
        Scan::Surface(surface) => surface,
    };
    let triangles = surface.mesh.triangulate();
    let normals = triangles.vertex_normals();
    let used: Vec<usize> = (0..normals.len())
        .filter(|&v| normals[v] != DVec3::ZERO)
        .collect();
    PointCloud {
        positions: used.iter().map(|&v| triangles.positions[v]).collect(),
        confidence: match surface.confidence.is_empty() {
            true => Vec::new(),
            false => used.iter().map(|&v| surface.confidence[v]).collect(),
        },
        normals: used.iter().map(|&v| normals[v]).collect(),
    }
}
