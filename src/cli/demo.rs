//! `vorofit demo`: the main job on the built-in scan.

use super::job::{Job, Method, PagePlace, Target, warn_of_flaws};
use super::outputs::Outputs;
use super::session::Session;
use super::{Outcome, terminal};
use std::path::PathBuf;
use vorofit::files::{SurfaceToWrite, write_surface};
use vorofit::fit::{Checkpoints, Options, Template};
use vorofit::mesh::PolygonMesh;
use vorofit::mesh::check::Census;
use vorofit::picture::Axis;
use vorofit::report::page::check_folder;
use vorofit::report::{Settings, Stopwatch};
use vorofit::topology::Holes;
use vorofit::{Error, Result, demo};

/// Enough for the scan's noise: more would follow it.
const CONTROL_POINTS: usize = 1538;

/// Fit a built-in synthetic scan, write everything that `fit` can write, and say what to open first
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The folder to write into
    #[arg(short, long, default_value = "vorofit-demo", value_name = "DIR")]
    output: PathBuf,
}

impl Args {
    pub fn run(&self, session: &Session) -> Result<Outcome> {
        let folder = &self.output;
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        let within = |names: &[&str]| names.iter().map(|name| folder.join(name)).collect();
        let outputs = Outputs {
            control: within(&["control.obj", "control.usda"]),
            surface: within(&["surface.glb", "surface.ply"]),
        };
        let options = Options::default();
        let scan_file = folder.join("scan.ply");
        outputs.check(options.scheme, &[&scan_file])?;
        let page = PagePlace {
            folder: folder.join("report"),
            up: Axis::Z,
        };
        check_folder(&page.folder)?;
        session.device()?;
        terminal::catch_interrupts()?;

        let stopwatch = Stopwatch::start();
        session.terminal.stage("generating the scan");
        let scan: PolygonMesh = demo::scan(options.seed).into();
        write_surface(&scan_file, &SurfaceToWrite::dense(&scan, None))?;
        warn_of_flaws(session, &scan_file, &Census::of(&scan));
        Job {
            command: "demo",
            name: &scan_file,
            target: Target::Surface {
                mesh: &scan,
                confidence: &[],
            },
            settings: Settings::new("bbox".into(), Some(CONTROL_POINTS), Holes::Bridge, &options),
            method: Method::Voronoi {
                template: Template::BoundingBox {
                    control_points: CONTROL_POINTS,
                },
                options,
            },
            outputs,
            checkpoints: Checkpoints::default(),
            report: Some(folder.join("report.json")),
            page: Some(page),
        }
        .run(session, stopwatch)
    }
}
