//! Volume meshes from files and into files, one file per format.
//!
//! Reading: [`read_volume`] takes Medit, legacy VTK, VTU, MSH and MFEM files. Tetrahedra, prisms and hexahedra make the mesh; points, lines
//! and surface elements are counted and left out; other cells are refused by name, pyramids if [`Pyramids`] says so. Where all cells of a shape are numbered the
//! other way round, they are turned; single inverted cells stay. Corners at identical positions are merged, because cells that touch
//! without sharing vertices would come apart. What is left must fit together ([`crate::mesh::check_volume`]).
//!
//! Writing: [`write_volume`] takes a [`VolumeToWrite`]; a format that cannot hold it refuses and names one that can.
//!
//! | extension | read | written | curved cells |
//! | --- | --- | --- | --- |
//! | `.mesh` (Medit), `.meshb` | text, binary | no | none |
//! | `.vtk` | text, binary | no | Lagrange cells to order 16 |
//! | `.vtu` | text, base64, appended, zlib | base64 with zlib | Lagrange cells to order 16, nodes as in VTK 9.1 and later (file version 2.2) |
//! | `.mesh` (MFEM) | text | text | discontinuous equispaced nodes (`L2_T4_3D_Pp`); of others the vertices only |
//! | `.msh` (4.1) | text, binary | binary | tetrahedra to order 10, hexahedra to 9, prisms to 2, as far as Gmsh has bases |
//!
//! Data on nodes and cells is written to `.vtu` and `.msh`; MFEM keeps such data in files of its own.

mod draft;
mod legacy_vtk;
mod medit;
mod mfem;
mod msh;
mod numbering;
mod scan;
mod vtk;
mod vtu;
mod vtu_array;

use crate::error::{Defect, Error, Result};
use crate::files::write_whole;
use crate::mesh::{NodalVolume, VolumeMesh};
use std::io::{self, Write};
use std::path::Path;

/// A volume mesh as it was in its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// The cells with straight edges, sound in the sense of [`crate::mesh::check_volume::sound`].
    pub mesh: VolumeMesh,
    /// The curved cells, cell for cell those of `mesh`, where the file has them.
    pub nodes: Option<NodalVolume>,
    /// What was left out or put right, a line each.
    pub warnings: Vec<String>,
}

/// What becomes of the pyramids of a file: elements do not come in this shape.
///
/// Nothing else can take their place: two tetrahedra have triangles where the cell on the other side of the base has a quad, and would come
/// apart from it when they are curved.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Pyramids {
    /// A file that has some is refused.
    #[default]
    Refused,
    /// The mesh is read without them: their neighbours' faces become boundary, so that each group of pyramids is a hole with a surface
    /// of its own.
    LeftOut,
}

/// Reads a volume mesh; the format is told by the extension, in any case of letters, Medit's and MFEM's `.mesh` by the content.
///
/// Vertices keep the file's order. Data on points and cells is passed over.
///
/// # Errors
/// Where the file cannot be read, is of another format than its name says, is truncated or malformed, holds cells that are not supported,
/// or fails [`crate::mesh::check_volume::sound`].
pub fn read_volume(path: &Path, pyramids: Pyramids) -> Result<Volume> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    volume_from_bytes(path, &bytes, pyramids)
}

/// Like [`read_volume`], with the content of the file given; `path` says the format and is named in errors.
///
/// # Errors
/// As [`read_volume`].
pub fn volume_from_bytes(path: &Path, bytes: &[u8], pyramids: Pyramids) -> Result<Volume> {
    read(path, bytes, pyramids).map_err(|defect| defect.in_file(path))
}

fn read(path: &Path, bytes: &[u8], pyramids: Pyramids) -> Result<Volume, Defect> {
    let format = Format::of(path, bytes)?;
    if bytes.is_empty() {
        return Err(Defect::new("start", "the file is empty", "export it again"));
    }
    if let Some(content) = Format::sniff(bytes)
        && content != format
    {
        return Err(Defect::new(
            "start",
            format!(
                "the name says {}, the content {}",
                format.name(),
                content.name()
            ),
            "give the file the extension of its content",
        ));
    }
    let draft = match format {
        Format::Medit => medit::read(bytes),
        Format::MeditBinary => medit::read_binary(bytes),
        Format::LegacyVtk => legacy_vtk::read(bytes),
        Format::Vtu => vtu::read(bytes),
        Format::Msh => msh::read(bytes),
        Format::Mfem => mfem::read(bytes),
    };
    draft?.finish(pyramids)
}

/// What goes into a file: cells with their nodes, and numbers on them.
#[derive(Debug, Clone, Copy)]
pub struct VolumeToWrite<'a> {
    /// The cells; neighbours share nodes.
    pub nodes: &'a NodalVolume,
    /// Names, and `[nodes]` each: a distance in the units of the positions, for one.
    pub node_data: &'a [(&'a str, &'a [f64])],
    /// Names, and `[cells]` each.
    pub cell_data: &'a [(&'a str, &'a [f64])],
}

impl<'a> VolumeToWrite<'a> {
    /// A volume without data on it.
    pub fn new(nodes: &'a NodalVolume) -> Self {
        Self {
            nodes,
            node_data: &[],
            cell_data: &[],
        }
    }

    fn check(&self) -> Result<(), Defect> {
        let refuse = |place: &str, problem: String| {
            Err(Defect::new(place, problem, "give the data of this volume"))
        };
        let nodes = self.nodes.positions.len();
        if !(1..=draft::MAX_ORDER).contains(&self.nodes.order()) {
            return refuse(
                "order",
                format!(
                    "it is {}, not one from 1 to {}",
                    self.nodes.order(),
                    draft::MAX_ORDER
                ),
            );
        }
        if self.nodes.cell_count() == 0 {
            return refuse("cells", "there are none".into());
        }
        if self
            .nodes
            .cells()
            .any(|(_, cell)| cell.iter().any(|&node| node as usize >= nodes))
        {
            return refuse("cells", format!("a node is not one of the {nodes}"));
        }
        if self.nodes.positions.iter().any(|p| !p.is_finite()) {
            return refuse("nodes", "a coordinate is not finite".into());
        }
        for (data, count) in [
            (self.node_data, nodes),
            (self.cell_data, self.nodes.cell_count()),
        ] {
            for (name, values) in data {
                if values.len() != count {
                    return refuse(name, format!("{} values for {count} places", values.len()));
                }
                if values.iter().any(|x| !x.is_finite()) {
                    return refuse(name, "a value is not finite".into());
                }
                if name.is_empty() || name.contains(|c: char| "<>&\"".contains(c) || c.is_control())
                {
                    return refuse(name, "the name of the data cannot be written".into());
                }
            }
        }
        Ok(())
    }
}

/// Whether [`write_volume`] would take the volume under this name: to be asked, with [`crate::files::check_place`], before the work.
///
/// # Errors
/// Where the extension is not that of a format that is written, the format has no such cells, or data does not fit the volume.
pub fn check_volume_writable(path: &Path, volume: &VolumeToWrite<'_>) -> Result<()> {
    writer(path, volume)
        .map(|_| ())
        .map_err(|defect| defect.in_file(path))
}

/// Writes a volume, whole or not at all; the format is told by the extension, `.mesh` is MFEM's.
///
/// # Errors
/// As [`check_volume_writable`], and where the file cannot be written.
pub fn write_volume(path: &Path, volume: &VolumeToWrite<'_>) -> Result<()> {
    let write = writer(path, volume).map_err(|defect| defect.in_file(path))?;
    write_whole(path, |out| write(out, volume))
}

type Writer = fn(&mut dyn Write, &VolumeToWrite<'_>) -> io::Result<()>;

/// The writer of a format that can hold the volume.
fn writer(path: &Path, volume: &VolumeToWrite<'_>) -> Result<Writer, Defect> {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    let write: Writer = match extension.to_str() {
        Some("vtu") => vtu::write,
        Some("mesh") => mfem::write,
        Some("msh") => msh::write,
        _ => {
            return Err(Defect::new(
                "extension",
                format!("{extension:?} is no format that volumes are written in"),
                "use .vtu, .mesh (MFEM) or .msh",
            ));
        }
    };
    volume.check()?;
    if extension == "msh" {
        msh::check_holds(volume.nodes)?;
    }
    Ok(write)
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Medit,
    MeditBinary,
    LegacyVtk,
    Vtu,
    Msh,
    Mfem,
}

impl Format {
    /// The format by the name; the content decides between Medit and MFEM.
    fn of(path: &Path, bytes: &[u8]) -> Result<Self, Defect> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        Ok(match extension.to_str() {
            Some("mesh") if bytes.starts_with(mfem::MAGIC) => Self::Mfem,
            Some("mesh") => Self::Medit,
            Some("meshb") => Self::MeditBinary,
            Some("vtk") => Self::LegacyVtk,
            Some("vtu") => Self::Vtu,
            Some("msh") => Self::Msh,
            _ => {
                return Err(Defect::new(
                    "extension",
                    format!("{extension:?} is no format of volume meshes known here"),
                    "use .mesh (Medit or MFEM), .meshb, .vtk, .vtu or .msh",
                ));
            }
        })
    }

    /// The format that the content declares itself to be, where it does.
    fn sniff(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(mfem::MAGIC) {
            Some(Self::Mfem)
        } else if bytes.starts_with(msh::MAGIC) {
            Some(Self::Msh)
        } else if bytes.starts_with(legacy_vtk::MAGIC) {
            Some(Self::LegacyVtk)
        } else if vtu::recognize(bytes) {
            Some(Self::Vtu)
        } else if medit::recognize(bytes) {
            Some(Self::Medit)
        } else {
            None
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Medit => "Medit",
            Self::MeditBinary => "binary Medit",
            Self::LegacyVtk => "legacy VTK",
            Self::Vtu => "VTU",
            Self::Msh => "MSH",
            Self::Mfem => "MFEM",
        }
    }
}
