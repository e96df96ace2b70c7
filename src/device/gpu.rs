//! An open GPU: its compiled pipelines, and failures turned into errors.

use super::{Adapter, Batch, Constants, Shader};
use crate::error::{Error, Result};
use std::collections::HashMap;
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

const REMEDY: &str = "run on the CPU, or choose another adapter";

/// An open GPU. Cheap to clone; clones share the device and its pipelines.
#[derive(Debug, Clone)]
pub struct Gpu {
    context: Arc<Context>,
    pipelines: Arc<Mutex<HashMap<String, Pipeline>>>,
    faults: Vec<Fault>,
}

/// A shader made ready to run.
#[derive(Debug, Clone)]
pub struct Pipeline {
    pub(super) raw: wgpu::ComputePipeline,
    pub(super) name: &'static str,
}

#[derive(Debug)]
struct Context {
    adapter: Adapter,
    device: wgpu::Device,
    queue: wgpu::Queue,
    /// The first failure that no error scope caught, such as the loss of the device. Every later call reports it.
    failure: Arc<Mutex<Option<String>>>,
    /// Readback buffers that are not in use.
    staging: Mutex<Vec<wgpu::Buffer>>,
}

/// A deliberate error in a shader's text.
#[derive(Debug, Clone)]
struct Fault {
    shader: String,
    from: String,
    to: String,
}

impl Gpu {
    /// Opens an adapter with wgpu's default limits and no optional feature.
    ///
    /// # Errors
    /// Where the driver refuses.
    pub fn open(adapter: &Adapter) -> Result<Self> {
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("vorofit"),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.raw.request_device(&descriptor))
            .map_err(|e| Error::device(format!("{}: {e}", adapter.name), REMEDY))?;
        let failure = Arc::new(Mutex::new(None));
        let uncaught = Arc::clone(&failure);
        device.on_uncaptured_error(Arc::new(move |e| record(&uncaught, e.to_string())));
        let lost = Arc::clone(&failure);
        device.set_device_lost_callback(move |reason, message| {
            record(&lost, format!("the device was lost ({reason:?}) {message}"));
        });
        Ok(Self {
            context: Arc::new(Context {
                adapter: adapter.clone(),
                device,
                queue,
                failure,
                staging: Mutex::default(),
            }),
            pipelines: Arc::default(),
            faults: Vec::new(),
        })
    }

    /// The adapter it was opened on.
    pub fn adapter(&self) -> &Adapter {
        &self.context.adapter
    }

    /// The same device with the first `from` in the text of a shader replaced by `to`. Tests plant faults this way: a comparison of twins
    /// that cannot fail proves nothing.
    pub fn with_fault(&self, shader: &Shader, from: &str, to: &str) -> Self {
        let mut faults = self.faults.clone();
        faults.push(Fault {
            shader: shader.name.into(),
            from: from.into(),
            to: to.into(),
        });
        Self {
            context: Arc::clone(&self.context),
            pipelines: Arc::default(),
            faults,
        }
    }

    /// Gives the device up. What is run on it or on a clone afterwards fails; tests use it to see that.
    pub fn lose(&self) {
        self.device().destroy();
    }

    /// Begins a list of dispatches.
    pub fn batch(&self) -> Batch {
        Batch::new(self)
    }

    /// Compiles a variant of a shader, once.
    ///
    /// # Errors
    /// Where the text is invalid or the driver refuses it.
    pub fn pipeline(&self, shader: &Shader, constants: Constants<'_>) -> Result<Pipeline> {
        let key = format!("{} {constants:?}", shader.name);
        if let Some(pipeline) = lock(&self.pipelines).get(&key) {
            return Ok(pipeline.clone());
        }
        let mut assembled = shader.assemble(constants);
        for fault in self.faults.iter().filter(|f| f.shader == shader.name) {
            if !assembled.text.contains(&fault.from) {
                return Err(Error::input(
                    format!("the text of '{}' lacks '{}'", shader.name, fault.from),
                    "plant the fault elsewhere",
                ));
            }
            assembled.text = assembled.text.replacen(&fault.from, &fault.to, 1);
        }
        assembled.validate()?;
        let pipeline = Pipeline {
            raw: self.compile(shader.name, assembled.text)?,
            name: shader.name,
        };
        lock(&self.pipelines).insert(key, pipeline.clone());
        Ok(pipeline)
    }

    fn compile(&self, name: &str, text: String) -> Result<wgpu::ComputePipeline> {
        let device = self.device();
        self.guarded(|| {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(name),
                source: wgpu::ShaderSource::Wgsl(text.into()),
            });
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: None,
                module: &module,
                entry_point: Some(name),
                compilation_options: Default::default(),
                cache: None,
            })
        })
    }

    /// Runs calls to wgpu; what they report becomes an error.
    pub(super) fn guarded<T>(&self, calls: impl FnOnce() -> T) -> Result<T> {
        use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
        let scopes = [OutOfMemory, Validation, Internal].map(|f| self.device().push_error_scope(f));
        let value = calls();
        // Scopes are a stack: the last one pushed is popped first, and all of them before an error is returned.
        let errors: Vec<_> = scopes
            .into_iter()
            .rev()
            .map(|scope| pollster::block_on(scope.pop()))
            .collect();
        match errors.into_iter().flatten().next() {
            Some(wgpu::Error::OutOfMemory { .. }) => Err(Error::device(
                format!("{}: out of memory", self.adapter().name),
                "use a smaller mesh, close other programs, or run on the CPU",
            )),
            Some(error) => Err(Error::device(
                format!("{}: {error}", self.adapter().name),
                REMEDY,
            )),
            None => self.check().map(|()| value),
        }
    }

    /// Waits until everything submitted has run.
    pub(super) fn wait(&self) -> Result<()> {
        // wgpu 30 panics where the device is lost while it waits; that is a failure like any other here.
        let polled = std::panic::catch_unwind(AssertUnwindSafe(|| {
            self.device().poll(wgpu::PollType::wait_indefinitely())
        }));
        self.check()?;
        match polled {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(e)) => Err(Error::device(e.to_string(), REMEDY)),
            Err(_) => Err(Error::device("the device was lost", REMEDY)),
        }
    }

    fn check(&self) -> Result<()> {
        match &*lock(&self.context.failure) {
            Some(failure) => Err(Error::device(
                format!("{}: {failure}", self.adapter().name),
                REMEDY,
            )),
            None => Ok(()),
        }
    }

    /// A readback buffer of at least `bytes`; give it back with [`store_staging`](Self::store_staging).
    pub(super) fn take_staging(&self, bytes: u64) -> Result<wgpu::Buffer> {
        let mut free = lock(&self.context.staging);
        if let Some(fits) = free.iter().position(|b| b.size() >= bytes) {
            return Ok(free.swap_remove(fits));
        }
        // One that grew too small is replaced, not kept beside.
        free.pop();
        drop(free);
        self.guarded(|| {
            self.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("staging"),
                size: bytes.next_power_of_two(),
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }

    pub(super) fn store_staging(&self, buffer: wgpu::Buffer) {
        lock(&self.context.staging).push(buffer);
    }

    pub(super) fn device(&self) -> &wgpu::Device {
        &self.context.device
    }

    pub(super) fn queue(&self) -> &wgpu::Queue {
        &self.context.queue
    }

    /// The most bytes a buffer may have.
    pub(super) fn largest_buffer(&self) -> u64 {
        self.device().limits().max_buffer_size
    }

    /// The most bytes a shader may see of a buffer. Callers split what is larger.
    pub fn largest_binding(&self) -> u64 {
        self.device().limits().max_storage_buffer_binding_size
    }
}

fn record(slot: &Mutex<Option<String>>, failure: String) {
    log::error!("{failure}");
    lock(slot).get_or_insert(failure);
}

/// What these locks guard is whole between any two statements, so a panic elsewhere does not spoil it.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
