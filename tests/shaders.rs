//! Every shader text is valid for every target, within wgpu's default limits. Needs no device.

use naga::{AddressSpace, ShaderStage, back};
use std::collections::HashSet;
use vorofit::device::{Shader, WORKGROUP_SIZE};
use vorofit::kernel::SHADERS;

/// A shader's module and what the validator found out about it.
fn validated(shader: &Shader) -> (naga::Module, naga::valid::ModuleInfo) {
    shader
        .assemble(shader.constants)
        .validate()
        .unwrap_or_else(|e| panic!("{}: {e}", shader.name))
}

#[test]
fn shaders_stay_within_the_default_limits() {
    for shader in SHADERS {
        let (module, info) = validated(shader);
        let [entry] = module.entry_points.as_slice() else {
            panic!("{}: one entry point expected", shader.name);
        };
        assert_eq!(entry.name, shader.name);
        assert_eq!(entry.workgroup_size, [WORKGROUP_SIZE, 1, 1]);
        let (mut storage, mut workgroup_bytes) = (0, 0);
        for (handle, global) in module.global_variables.iter() {
            // The layout of a pipeline is derived from what its entry point uses.
            assert!(
                !info.get_entry_point(0)[handle].is_empty(),
                "{}: {:?} is never used",
                shader.name,
                global.name
            );
            match global.space {
                AddressSpace::Storage { .. } => storage += 1,
                AddressSpace::WorkGroup => {
                    workgroup_bytes += module.types[global.ty].inner.size(module.to_ctx());
                }
                _ => {}
            }
        }
        assert!(storage <= 8, "{}: {storage} storage buffers", shader.name);
        assert!(workgroup_bytes <= 16 << 10, "{}", shader.name);
    }
}

#[test]
fn shaders_translate_to_vulkan_metal_and_directx() {
    for shader in SHADERS {
        let (module, info) = validated(shader);
        let entry = (ShaderStage::Compute, shader.name.to_owned());
        let words = back::spv::write_vec(
            &module,
            &info,
            &back::spv::Options::default(),
            Some(&back::spv::PipelineOptions {
                shader_stage: entry.0,
                entry_point: entry.1.clone(),
            }),
        );
        assert!(!words.expect(shader.name).is_empty());
        let (text, _) = back::msl::write_string(
            &module,
            &info,
            &back::msl::Options {
                lang_version: (2, 0),
                ..Default::default()
            },
            &back::msl::PipelineOptions {
                entry_point: Some(entry.clone()),
                ..Default::default()
            },
        )
        .expect(shader.name);
        assert!(text.contains("kernel void"));
        let mut text = String::new();
        let options = back::hlsl::PipelineOptions {
            entry_point: Some(entry),
        };
        back::hlsl::Writer::new(&mut text, &back::hlsl::Options::default(), &options)
            .write(&module, &info, None)
            .expect(shader.name);
        assert!(text.contains("numthreads"));
    }
}

#[test]
fn shared_structs_have_one_layout_on_host_and_device() {
    for shader in SHADERS {
        let (module, _) = validated(shader);
        for layout in shader.structs {
            let (_, shared) = module
                .types
                .iter()
                .find(|(_, t)| t.name.as_deref() == Some(layout.name))
                .unwrap_or_else(|| panic!("{}: no {}", shader.name, layout.name));
            let naga::TypeInner::Struct { members, span } = &shared.inner else {
                panic!("{} is no struct", layout.name);
            };
            assert_eq!(*span as usize, layout.size, "size of {}", layout.name);
            let device: Vec<_> = members
                .iter()
                .map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize))
                .collect();
            let host: Vec<_> = layout
                .fields
                .iter()
                .map(|f| (f.name.to_owned(), f.offset))
                .collect();
            assert_eq!(device, host, "fields of {}", layout.name);
        }
    }
}

#[test]
fn every_shader_file_is_checked() {
    let known: HashSet<_> = SHADERS
        .iter()
        .flat_map(|s| s.sources)
        .map(|source| source.path.to_owned())
        .collect();
    for folder in ["shaders", "shaders/shared"] {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
        for entry in std::fs::read_dir(root.join(folder)).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            if name.ends_with(".wgsl") {
                assert!(known.contains(&format!("{folder}/{name}")), "{name}");
            }
        }
    }
}
