//! What crosses to the device in another layout than the host has it in: there, vectors are aligned to 16 bytes, and
//! there are no booleans. Fields are those of the host's structs of the same names.

use bytemuck::{Pod, Zeroable};
use texir_core::{backend, punctual};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct ShadePoint {
    pub position: [f32; 3],
    pub index: u32,
    pub normal: [f32; 3],
    pub pad0: f32,
    pub view: [f32; 3],
    pub pad1: f32,
    pub irradiance: [f32; 3],
    pub pad2: f32,
}

impl From<&backend::ShadePoint> for ShadePoint {
    fn from(point: &backend::ShadePoint) -> Self {
        let backend::ShadePoint { position, index, normal, view, irradiance } = *point;
        Self { position, index, normal, view, irradiance, ..Self::zeroed() }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Material {
    pub albedo: [f32; 3],
    pub roughness: f32,
    pub metallic: f32,
    pub pad: [f32; 3],
}

impl From<&backend::Material> for Material {
    fn from(material: &backend::Material) -> Self {
        let backend::Material { albedo, roughness, metallic } = *material;
        Self { albedo, roughness, metallic, ..Self::zeroed() }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Shaded {
    pub radiance: [f32; 3],
    pub pad0: f32,
    pub specular_scale: [f32; 3],
    pub pad1: f32,
    pub roughness_jacobian: [f32; 3],
    pub pad2: f32,
}

impl From<&backend::Shaded> for Shaded {
    fn from(shaded: &backend::Shaded) -> Self {
        let backend::Shaded { radiance, specular_scale, roughness_jacobian } = *shaded;
        Self { radiance, specular_scale, roughness_jacobian, ..Self::zeroed() }
    }
}

impl From<Shaded> for backend::Shaded {
    fn from(shaded: Shaded) -> Self {
        let Shaded { radiance, specular_scale, roughness_jacobian, .. } = shaded;
        Self { radiance, specular_scale, roughness_jacobian }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct MaterialGrad {
    pub albedo: [f32; 3],
    pub roughness: f32,
    pub metallic: f32,
    pub pad: [f32; 3],
}

impl From<MaterialGrad> for backend::MaterialGrad {
    fn from(gradient: MaterialGrad) -> Self {
        let MaterialGrad { albedo, roughness, metallic, .. } = gradient;
        Self { albedo, roughness, metallic }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct PunctualLight {
    pub position: [f32; 3],
    pub distant: u32,
    pub direction: [f32; 3],
    pub inverse_range: f32,
    pub intensity: [f32; 3],
    pub cone_scale: f32,
    pub cone_offset: f32,
    pub pad: [f32; 3],
}

impl From<&punctual::PunctualLight> for PunctualLight {
    fn from(light: &punctual::PunctualLight) -> Self {
        let punctual::Coefficients { position, distant, direction, inverse_range, intensity, cone_scale, cone_offset } =
            light.coefficients();
        let distant = u32::from(distant);
        Self { position, distant, direction, inverse_range, intensity, cone_scale, cone_offset, ..Self::zeroed() }
    }
}

/// All of them, as the device has them.
pub(crate) fn laid_out<'a, H: 'a, D: From<&'a H>>(values: impl IntoIterator<Item = &'a H>) -> Vec<D> {
    values.into_iter().map(D::from).collect()
}
