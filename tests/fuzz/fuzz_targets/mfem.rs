#![no_main]
use std::path::Path;
use vorofit::files::Pyramids;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // Without its first word the content would be taken for Medit's.
    let content = [&b"MFEM mesh v1.0\n"[..], bytes].concat();
    let _ = vorofit::files::volume_from_bytes(Path::new("fuzz.mesh"), &content, Pyramids::LeftOut);
});
