#![no_main]
use std::path::Path;
use vorofit::files::Pyramids;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = vorofit::files::volume_from_bytes(Path::new("fuzz.vtk"), bytes, Pyramids::LeftOut);
});
