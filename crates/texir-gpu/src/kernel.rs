//! Compute pipelines, with resources bound by the names that they have in WGSL.

use std::collections::HashMap;
use std::sync::Arc;

use texir_core::error::{Error, Result};

use crate::wgsl::{Composed, SHADERS, Variant};

/// Largest number of workgroups in one dimension of a dispatch that every adapter takes.
const MAX_WORKGROUPS: u64 = 65_535;

/// Which kernel: a shader, its entry point, its variant and its override constants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct KernelKey {
    /// Stem of the shader's file.
    pub shader: &'static str,
    /// Entry point.
    pub entry: &'static str,
    /// Modules behind stand-in names.
    pub variant: Variant,
    /// An override constant.
    pub constant: Option<(&'static str, u32)>,
}

/// Kernels made so far: each is compiled when it is first used.
#[derive(Default)]
pub(crate) struct Kernels(HashMap<KernelKey, Arc<Kernel>>);

impl Kernels {
    pub fn get(&mut self, device: &wgpu::Device, spec: KernelKey) -> Result<Arc<Kernel>> {
        if let Some(kernel) = self.0.get(&spec) {
            return Ok(kernel.clone());
        }
        let kernel = Arc::new(Kernel::new(device, spec)?);
        self.0.insert(spec, kernel.clone());
        Ok(kernel)
    }
}

/// A resource variable of an entry point.
#[derive(Clone, Debug, PartialEq)]
struct Slot {
    name: String,
    group: u32,
    entry: wgpu::BindGroupLayoutEntry,
}

/// A compute pipeline.
pub(crate) struct Kernel {
    spec: KernelKey,
    label: String,
    pipeline: wgpu::ComputePipeline,
    layouts: Vec<wgpu::BindGroupLayout>,
    slots: Vec<Slot>,
    /// Resource variables of the module that this entry point does not use.
    unused: Vec<String>,
}

impl Kernel {
    fn new(device: &wgpu::Device, spec: KernelKey) -> Result<Self> {
        let label = format!("{}/{}", spec.shader, spec.entry);
        let composed = SHADERS.compose(spec.shader, spec.variant)?;
        let (slots, unused) = reflect(&composed, spec.entry)?;
        let groups = slots.iter().map(|s| s.group + 1).max().unwrap_or(0);
        let layouts: Vec<_> = (0..groups)
            .map(|group| {
                let entries: Vec<_> = slots.iter().filter(|s| s.group == group).map(|s| s.entry).collect();
                let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(&label), entries: &entries };
                device.create_bind_group_layout(&descriptor)
            })
            .collect();
        let source = wgpu::ShaderSource::Wgsl(composed.source.into());
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(&label), source };
        let checks = wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..wgpu::ShaderRuntimeChecks::checked() };
        // SAFETY: all checks stay on but the one against endless loops, and every loop of these shaders ends: it counts
        // up to a bound, or consumes a finite hierarchy. The check is a counter in the hot loop of the traversal.
        let module = unsafe { device.create_shader_module_trusted(descriptor, checks) };
        let all: Vec<_> = layouts.iter().map(Some).collect();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(&label),
            bind_group_layouts: &all,
            immediate_size: 0,
        });
        let constants: Vec<_> = spec.constant.iter().map(|&(name, value)| (name, f64::from(value))).collect();
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(&label),
            layout: Some(&layout),
            module: &module,
            entry_point: Some(spec.entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants,
                zero_initialize_workgroup_memory: false,
            },
            cache: None,
        });
        Ok(Self { spec, label, pipeline, layouts, slots, unused })
    }

    /// Which kernel it is.
    pub fn key(&self) -> KernelKey {
        self.spec
    }

    /// Binds resources by variable name. Every variable of the entry point needs one; a name that the shader does not
    /// declare is an error, one that only other entry points use is passed over.
    pub fn bind(
        &self,
        device: &wgpu::Device,
        resources: &[(&str, wgpu::BindingResource)],
    ) -> Result<Vec<wgpu::BindGroup>> {
        for (name, _) in resources {
            if !self.slots.iter().any(|s| s.name == *name) && !self.unused.iter().any(|u| u == name) {
                return Err(Error::device(format!("{}: the shader has no variable {name:?} to bind", self.label)));
            }
        }
        let mut groups = Vec::with_capacity(self.layouts.len());
        for (group, layout) in self.layouts.iter().enumerate() {
            let mut entries = Vec::new();
            for slot in self.slots.iter().filter(|s| s.group as usize == group) {
                let Some((_, resource)) = resources.iter().find(|(name, _)| *name == slot.name) else {
                    return Err(Error::device(format!("{}: nothing is bound to {:?}", self.label, slot.name)));
                };
                entries.push(wgpu::BindGroupEntry { binding: slot.entry.binding, resource: resource.clone() });
            }
            let descriptor = wgpu::BindGroupDescriptor { label: Some(&self.label), layout, entries: &entries };
            groups.push(device.create_bind_group(&descriptor));
        }
        Ok(groups)
    }

    /// Records a dispatch of `workgroups` in a row, folded into two dimensions: the shader checks its index.
    pub fn record(&self, pass: &mut wgpu::ComputePass, groups: &[wgpu::BindGroup], workgroups: usize) {
        let (x, y) = fold(workgroups as u64);
        self.record_grid(pass, groups, x, y);
    }

    /// Records a dispatch of `x × y` workgroups.
    pub fn record_grid(&self, pass: &mut wgpu::ComputePass, groups: &[wgpu::BindGroup], x: u32, y: u32) {
        pass.set_pipeline(&self.pipeline);
        for (index, group) in groups.iter().enumerate() {
            pass.set_bind_group(index as u32, group, &[]);
        }
        pass.dispatch_workgroups(x, y, 1);
    }
}

/// Columns and rows of a dispatch: one row while it fits, else as few rows as do, evenly filled.
fn fold(workgroups: u64) -> (u32, u32) {
    let rows = workgroups.div_ceil(MAX_WORKGROUPS).max(1);
    (workgroups.div_ceil(rows) as u32, rows as u32)
}

/// The resource variables that an entry point uses, and the names of those it does not.
fn reflect(composed: &Composed, entry: &str) -> Result<(Vec<Slot>, Vec<String>)> {
    let module = &composed.module;
    let Some(index) = module.entry_points.iter().position(|e| e.name == entry) else {
        return Err(Error::device(format!("the shader has no entry point {entry:?}")));
    };
    let usage = composed.info.get_entry_point(index);
    let (mut slots, mut unused) = (Vec::new(), Vec::new());
    for (handle, variable) in module.global_variables.iter() {
        let (Some(binding), Some(name)) = (&variable.binding, &variable.name) else { continue };
        if usage[handle].is_empty() {
            unused.push(name.clone());
            continue;
        }
        let ty = binding_type(module, variable)
            .ok_or_else(|| Error::device(format!("{name}: a kind of resource that no kernel of ours has")))?;
        let entry = wgpu::BindGroupLayoutEntry {
            binding: binding.binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty,
            count: None,
        };
        slots.push(Slot { name: name.clone(), group: binding.group, entry });
    }
    Ok((slots, unused))
}

fn binding_type(module: &naga::Module, variable: &naga::GlobalVariable) -> Option<wgpu::BindingType> {
    let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
    match (variable.space, &module.types[variable.ty].inner) {
        (naga::AddressSpace::Uniform, _) => Some(buffer(wgpu::BufferBindingType::Uniform)),
        (naga::AddressSpace::Storage { access }, _) => {
            let read_only = !access.contains(naga::StorageAccess::STORE);
            Some(buffer(wgpu::BufferBindingType::Storage { read_only }))
        }
        (
            naga::AddressSpace::Handle,
            naga::TypeInner::Image {
                dim: naga::ImageDimension::D2,
                arrayed: false,
                class: naga::ImageClass::Sampled { kind: naga::ScalarKind::Float, multi: false },
            },
        ) => Some(wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: false },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        }),
        (
            naga::AddressSpace::Handle,
            naga::TypeInner::Image {
                dim: naga::ImageDimension::D2,
                arrayed: false,
                class:
                    naga::ImageClass::Storage {
                        format: naga::StorageFormat::Rgba32Float,
                        access: naga::StorageAccess::LOAD,
                    },
            },
        ) => Some(wgpu::BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::ReadOnly,
            format: wgpu::TextureFormat::Rgba32Float,
            view_dimension: wgpu::TextureViewDimension::D2,
        }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folded_dispatches_cover_every_workgroup_within_the_limit() {
        for n in [1, 2, 65_535, 65_536, 131_071, 10_000_000, 4_000_000_000] {
            let (x, y) = fold(n);
            assert!(
                u64::from(x) * u64::from(y) >= n && u64::from(x) <= MAX_WORKGROUPS && u64::from(y) <= MAX_WORKGROUPS
            );
            assert!(u64::from(x) * u64::from(y) < n + u64::from(y));
        }
    }
}
