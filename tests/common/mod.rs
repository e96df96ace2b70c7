//! What tests share: one open device, noise, the public data, and ways to be interrupted.

#![allow(dead_code, reason = "each test binary uses a part")]

pub mod elements;
pub mod volumes;

use glam::DVec3;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use vorofit::device::{Adapter, Gpu, Shader};
use vorofit::kernel::Kernel;
use vorofit::progress::{Event, Progress};

/// A file of the public data, which is no part of the repository: in `../shared/data`, or where `VOROFIT_DATA` says. One that is not
/// there is named.
pub fn data(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("VOROFIT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if !path.exists() {
        eprintln!("skipped: {name} is not in {}", folder.display());
        return None;
    }
    Some(path)
}

/// The machine's GPU, software included. Tests that need one fail where there is none; they never skip.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| {
        quiet_driver();
        let adapter = Adapter::select(None).unwrap_or_else(|e| panic!("{e}"));
        Gpu::open(&adapter).unwrap_or_else(|e| panic!("{e}"))
    })
}

/// Mesa complains on stderr where there is no private runtime directory.
pub fn quiet_driver() {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: what reads the environment in these tests does so through the standard library's lock, or after this in the
        // same initialization (the driver).
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", env!("CARGO_TARGET_TMPDIR")) };
    }
}

/// The disagreement of the twins on a device, in units of the kernel's tolerance.
pub fn disagreement<K: Kernel>(gpu: &Gpu, input: &K::Input) -> f64 {
    let mut resident = K::upload(gpu, input).expect(K::NAME);
    let output = K::gpu(gpu, &mut resident).expect(K::NAME);
    K::compare(input, &K::cpu(input), &output) / K::TOLERANCE
}

/// The twins agree on every input.
pub fn agree<K: Kernel>(inputs: &[(&str, K::Input)]) {
    for (name, input) in inputs {
        let ratio = disagreement::<K>(gpu(), input);
        println!(
            "{} on {name}: {:.2e} = {ratio:.3} of the tolerance",
            K::NAME,
            ratio * K::TOLERANCE
        );
        assert!(
            ratio <= 1.0,
            "{} on {name}: {ratio} tolerances apart",
            K::NAME
        );
    }
}

/// Each fault, planted alone in the shader, is seen on the input.
pub fn sees<K: Kernel>(shader: &Shader, input: &K::Input, faults: &[(&str, &str)]) {
    for (from, to) in faults {
        let ratio = disagreement::<K>(&gpu().with_fault(shader, from, to), input);
        assert!(
            ratio > 1.0,
            "{}: '{from}' → '{to}' goes unseen ({ratio})",
            K::NAME
        );
    }
}

/// Two runs give the same bits.
pub fn repeats<K: Kernel<Output: PartialEq>>(input: &K::Input) {
    let run = || K::gpu(gpu(), &mut K::upload(gpu(), input).expect(K::NAME)).expect(K::NAME);
    assert!(run() == run(), "{}: two runs differ", K::NAME);
}

/// A small multiplicative congruential generator: tests need noise, not quality.
pub struct Noise(pub u64);

impl Noise {
    /// Uniform in [−½, ½).
    pub fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }

    /// Uniform in [−½, ½)³.
    pub fn vector(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }

    /// Uniform in 0..n.
    pub fn below(&mut self, n: usize) -> usize {
        (((self.next() + 0.5) * n as f64) as usize).min(n - 1)
    }
}

/// Asks to stop after a number of steps in stages whose name begins so.
pub struct StopsAfter {
    stage: &'static str,
    steps: usize,
    counts: AtomicBool,
    seen: AtomicUsize,
}

impl StopsAfter {
    pub fn new(stage: &'static str, steps: usize) -> Self {
        Self {
            stage,
            steps,
            counts: AtomicBool::new(false),
            seen: AtomicUsize::new(0),
        }
    }
}

impl Progress for StopsAfter {
    fn event(&self, event: Event<'_>) {
        match event {
            Event::Stage { name, .. } => {
                let counts = name.starts_with(self.stage);
                self.counts.store(counts, Ordering::Relaxed);
            }
            Event::Step { .. } if self.counts.load(Ordering::Relaxed) => {
                self.seen.fetch_add(1, Ordering::Relaxed);
            }
            _ => {}
        }
    }

    fn interrupted(&self) -> bool {
        self.seen.load(Ordering::Relaxed) >= self.steps
    }
}

/// Interrupts whatever asks.
pub struct Impatient;

impl Progress for Impatient {
    fn event(&self, _: Event<'_>) {}

    fn interrupted(&self) -> bool {
        true
    }
}
