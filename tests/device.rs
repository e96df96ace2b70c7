//! A device that refuses or fails gives errors that say what to do; it never panics.

mod common;

use common::gpu;
use vorofit::Error;
use vorofit::device::{Adapter, AdapterKind, Buffer, Device, DeviceChoice, adapters};
use vorofit::kernel::sum;

fn device_error<T>(result: vorofit::Result<T>) -> String {
    match result {
        Err(Error::Device { problem, remedy }) => format!("{problem}; {remedy}"),
        Err(other) => panic!("another error: {other}"),
        Ok(_) => panic!("no error"),
    }
}

#[test]
fn automatic_choice_never_takes_a_software_adapter() {
    common::quiet_driver();
    match Device::choose(DeviceChoice::Auto, None).unwrap() {
        Device::Cpu => assert!(adapters().iter().all(|a| a.kind == AdapterKind::Software)),
        Device::Gpu(gpu) => assert_ne!(gpu.adapter().kind, AdapterKind::Software),
    }
    assert!(matches!(
        Device::choose(DeviceChoice::Gpu, None),
        Ok(Device::Gpu(_))
    ));
}

#[test]
fn an_unknown_adapter_is_refused_with_the_names_of_those_there_are() {
    let known = &gpu().adapter().name;
    let error = device_error(Adapter::select(Some("no such adapter")));
    assert!(
        error.contains("no such adapter") && error.contains(known),
        "{error}"
    );
    let shouted = known.to_uppercase();
    assert_eq!(&Adapter::select(Some(&shouted)).unwrap().name, known);
    assert!(Device::choose(DeviceChoice::Cpu, Some(known)).is_err());
}

#[test]
fn a_buffer_beyond_the_limit_is_refused() {
    let error = device_error(Buffer::<[f32; 4]>::zeroed(gpu(), 1 << 40));
    assert!(error.contains("MiB"), "{error}");
    let error = device_error(Buffer::<[f32; 4]>::zeroed(gpu(), usize::MAX));
    assert!(error.contains("MiB"), "{error}");
}

#[test]
fn an_array_beyond_the_binding_limit_is_refused() {
    let len = gpu().largest_binding() as usize / 16 + 1;
    let large = Buffer::<[f32; 4]>::zeroed(gpu(), len).unwrap();
    let segments = sum::Segments::by_key([0u32].into_iter(), 1);
    let resident = sum::GpuSegments::new(gpu(), &segments).unwrap();
    let mut batch = gpu().batch();
    let records = sum::Records {
        values: &large,
        stride: 1,
        first: 0,
        width: 1,
    };
    let summed = resident.sum(gpu(), &mut batch, records, false, &large);
    let error = device_error(summed);
    assert!(
        error.contains("sum") && error.contains("128 MiB"),
        "{error}"
    );
}

#[test]
fn a_shader_that_does_not_compile_is_an_error_with_its_place() {
    let broken = gpu().with_fault(&sum::SHADER, "var total = vec4f(0.0)", "var total = 0u");
    let error = device_error(broken.pipeline(&sum::SHADER, &[]));
    assert!(error.contains("shaders/sum.wgsl:"), "{error}");
    let absent = gpu().with_fault(&sum::SHADER, "not there", "");
    assert!(absent.pipeline(&sum::SHADER, &[]).is_err());
}

#[test]
fn buffers_grow_and_keep_what_is_written() {
    let mut buffer = Buffer::from_slice(gpu(), &[1u32, 2]).unwrap();
    buffer.write(&(0..1000).collect::<Vec<u32>>()).unwrap();
    buffer.resize(3).unwrap();
    let empty = Buffer::<f32>::zeroed(gpu(), 0).unwrap();
    let mut batch = gpu().batch();
    let (first, none, again) = (batch.read(&buffer), batch.read(&empty), batch.read(&buffer));
    let results = batch.submit().unwrap();
    assert_eq!(results.get(&first), [0, 1, 2]);
    assert!(results.get(&none).is_empty());
    assert_eq!(results.get(&again), [0, 1, 2]);
}

#[test]
fn a_lost_device_is_an_error() {
    common::quiet_driver();
    let gpu = vorofit::device::Gpu::open(&Adapter::select(None).unwrap()).unwrap();
    let mut buffer = Buffer::from_slice(&gpu, &[1u32, 2]).unwrap();
    gpu.lose();
    let mut batch = gpu.batch();
    batch.read(&buffer);
    device_error(batch.submit());
    device_error(buffer.write(&[3; 1000]));
}
