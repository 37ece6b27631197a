//! The materials of an authored scene as they are written beside its lightmap.

use std::path::Path;

use gltf_json::Material;
use serde_json::Value;

use crate::error::{Error, Result};

/// The materials of the file `source`, their sets of coordinates [moved](with_sets) if so. Errors on numbers that
/// single precision does not hold.
pub fn materials(source: &Path, all: Vec<Material>, moved: bool) -> Result<Vec<Material>> {
    let of_material = |(i, material): (usize, Material)| {
        with_sets(&material, moved).map_err(|e| {
            let mut beyond = Vec::new();
            if let Ok(mut json) = serde_json::to_value(&material) {
                // What is no number has no form in JSON.
                for_fields(&mut json, &mut |name, value| {
                    let none = |value: &Value| value.is_null() && name != "texCoord";
                    if none(value) || value.as_array().is_some_and(|values| values.iter().any(none)) {
                        beyond.push(name.to_owned());
                    }
                });
            }
            let what = format!("materials[{i}]: {}: {e}; expected numbers of single precision", beyond.join(", "));
            Error::file(source, what)
        })
    };
    all.into_iter().enumerate().map(of_material).collect()
}

/// The material, its textures looked up one set further on where sets have `moved` up, except for those of TEXCOORD_0.
///
/// Every `texCoord` of a material is a set: that of a texture, of any extension, and of `KHR_texture_transform`, which
/// replaces it. One that replaces none is written as null by its serializer, which is no number of a set: it gets its
/// texture's.
fn with_sets(material: &Material, moved: bool) -> serde_json::Result<Material> {
    let mut json = serde_json::to_value(material)?;
    for_fields(&mut json, &mut |name, value| {
        let own = value.get("texCoord").and_then(Value::as_u64).unwrap_or(0);
        if let Some(set @ Value::Null) = value.pointer_mut("/extensions/KHR_texture_transform/texCoord") {
            *set = own.into();
        }
        if let (Some(set @ 1..), "texCoord", true) = (value.as_u64(), name, moved) {
            *value = set.saturating_add(1).into();
        }
    });
    serde_json::from_value(json)
}

/// Goes through all fields of a document, with their names, but for what applications keep for themselves: that follows
/// rules of its own.
pub fn for_fields(json: &mut Value, of: &mut impl FnMut(&str, &mut Value)) {
    match json {
        Value::Object(fields) => {
            for (name, value) in fields.iter_mut().filter(|(name, _)| *name != "extras") {
                of(name, value);
                for_fields(value, of);
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|value| for_fields(value, of)),
        _ => {}
    }
}
