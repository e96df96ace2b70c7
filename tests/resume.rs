//! Checkpoints: a fit that was interrupted goes on to the same bits, and nothing else is taken up.

#[path = "common/program.rs"]
mod program;

use program::{folder_with_scan, json, succeed};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use vorofit::Result;
use vorofit::device::Device;
use vorofit::fit::{
    Checkpoint, Checkpoints, Fit, Options, Start, StopReason, Target, Template,
    fit_with_checkpoints,
};
use vorofit::mesh::shapes;
use vorofit::progress::{Event, Progress, Silent};

/// Asks to stop in the first stage whose name begins so.
struct StopsIn(&'static str, AtomicBool);

impl Progress for StopsIn {
    fn event(&self, event: Event<'_>) {
        if let Event::Stage { name, .. } = event {
            self.1.fetch_or(name.starts_with(self.0), Ordering::Relaxed);
        }
    }

    fn interrupted(&self) -> bool {
        self.1.load(Ordering::Relaxed)
    }
}

/// A fit with a subdivision on the way.
fn run(options: &Options, progress: &dyn Progress, checkpoints: Checkpoints) -> Result<Fit> {
    let target = Target::new(&Device::Cpu, &shapes::sphere(1.0, 3))?;
    let template = Template::BoundingBox {
        control_points: 386,
    };
    let start = Start::new(&target, &template, options.scheme)?;
    fit_with_checkpoints(&Device::Cpu, &target, start, options, progress, checkpoints)
}

fn quick() -> Options {
    Options {
        levels: 1,
        ..Options::default()
    }
}

fn to(file: &Path) -> Checkpoints {
    Checkpoints {
        resume: None,
        file: Some(file.into()),
    }
}

fn from(file: &Path) -> Checkpoints {
    Checkpoints {
        resume: Some(Checkpoint::read(file).unwrap()),
        ..to(file)
    }
}

#[test]
fn an_interrupted_fit_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fit.checkpoint");
    let whole = run(&quick(), &Silent, Checkpoints::default()).unwrap();
    for stage in ["far", "near", "polish"] {
        let stops = StopsIn(stage, AtomicBool::new(false));
        let cut = run(&quick(), &stops, to(&file)).unwrap();
        assert_eq!(cut.stop_reason, StopReason::Interrupted, "{stage}");
        let resumed = run(&quick(), &Silent, from(&file)).unwrap();
        assert_eq!(resumed.control, whole.control, "{stage}");
        assert_eq!(resumed.surface, whole.surface, "{stage}");
        let energies = |fit: &Fit| fit.iterations.iter().map(|i| i.energy).collect::<Vec<_>>();
        assert_eq!(energies(&resumed), energies(&whole), "{stage}");
        assert_eq!(resumed.stages.len(), whole.stages.len());
    }
    // By now it holds a fit that is done.
    let done = run(&quick(), &StopsIn("", AtomicBool::new(false)), from(&file)).unwrap();
    assert_eq!(done.control, whole.control);
    assert_eq!(done.stop_reason, StopReason::Schedule);
}

#[test]
fn limits_may_change_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fit.checkpoint");
    let limited = Options {
        iterations: Some(1),
        ..quick()
    };
    let fit = run(&limited, &Silent, to(&file)).unwrap();
    assert_eq!(fit.stop_reason, StopReason::Iterations);
    let other = Options {
        smoothness: 0.02,
        ..quick()
    };
    let refusal = run(&other, &Silent, from(&file)).unwrap_err().to_string();
    assert!(refusal.contains("fit.checkpoint: fingerprint"), "{refusal}");
    let more = Options {
        iterations: Some(2),
        ..quick()
    };
    assert_eq!(
        run(&more, &Silent, from(&file)).unwrap().iterations.len(),
        2
    );
}

#[test]
fn what_is_no_checkpoint_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("fit.checkpoint");
    let limited = Options {
        iterations: Some(1),
        ..quick()
    };
    run(&limited, &Silent, to(&file)).unwrap();
    let whole = std::fs::read_to_string(&file).unwrap();
    for damaged in [
        String::new(),
        "[]".into(),
        whole[..whole.len() / 2].into(),
        whole.replace("checkpoint/1", "checkpoint/9"),
    ] {
        std::fs::write(&file, damaged).unwrap();
        let message = Checkpoint::read(&file).unwrap_err().to_string();
        assert!(message.contains("fit.checkpoint: ") && message.contains("without --resume"));
    }
    for [intact, damaged] in [
        ["\"phases\":0", "\"phases\":99"],
        ["\"phases\":0", "\"phases\":1"],
    ] {
        let text = whole
            .replace(intact, damaged)
            .replace("\"positions\":[[", "\"positions\":[[0,0,0],[");
        std::fs::write(&file, text).unwrap();
        let message = run(&quick(), &Silent, from(&file)).unwrap_err().to_string();
        assert!(message.contains("is damaged"), "{message}");
    }
    assert!(run(&quick(), &Silent, to(&folder.path().join("none/x"))).is_err());
}

#[test]
fn the_program_leaves_checkpoints_and_goes_on_from_them() {
    let folder = folder_with_scan("resume");
    let at = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let scan = at("scan.ply");
    let [whole, part, resumed, state] = ["whole.obj", "part.obj", "resumed.obj", "state"].map(at);
    let fit = |rest: &[&str]| {
        let start = ["fit", &scan, "--template", "bbox", "--control-points", "26"];
        succeed(&[&start, rest].concat());
    };
    let report = at("whole.json");
    fit(&["-o", &whole, "--json", &report]);
    // The last phase is left unfinished, so that the checkpoint is of those before it.
    let iterations = json(report.as_ref())["iterations"]
        .as_array()
        .expect("a list")
        .len();
    let most = (iterations - 5).to_string();
    fit(&["-o", &part, "--iterations", &most, "--checkpoint", &state]);
    fit(&["-o", &resumed, "--resume", &state]);
    let bytes = |path: &str| std::fs::read(path).expect("written");
    assert!(bytes(&part) != bytes(&whole));
    assert!(bytes(&resumed) == bytes(&whole));
}
