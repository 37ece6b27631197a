//! Materials that are double-sided to be seen, but send light from the fronts of their faces alone: of what was scanned,
//! the back of a wall is not known. glTF has no word for that: it stands in the material's `extras`.

use gltf_json::Extras;
use serde_json::Value;
use serde_json::value::RawValue;

/// What is said there.
const FRONT: &str = r#"{"texir_light":"front"}"#;

/// The extras of such a material.
pub(super) fn extras() -> Extras {
    RawValue::from_string(FRONT.to_owned()).ok()
}

/// Whether the extras of a material say so, among other things.
pub(crate) fn is_one_sided(extras: &Extras) -> bool {
    let says = |extras: &RawValue| {
        serde_json::from_str::<Value>(extras.get()).is_ok_and(|extras| extras["texir_light"] == "front")
    };
    extras.as_deref().is_some_and(says)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extras_of_others_do_not_say_so() {
        assert!(is_one_sided(&extras()));
        let of = |json: &str| Some(RawValue::from_string(json.to_owned()).unwrap());
        assert!(is_one_sided(&of(r#"{ "artist": [1], "texir_light": "front" }"#)));
        for other in [None, of("3"), of("[]"), of(r#"{ "texir_light": true }"#), of(r#""texir_light""#)] {
            assert!(!is_one_sided(&other), "{other:?}");
        }
    }
}
