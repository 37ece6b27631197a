//! Materials that are double-sided, and emit from the front of their faces alone, as fits see lamps. glTF has no word for
//! that: it stands in the material's `extras`.

use gltf_json::Extras;
use serde_json::Value;
use serde_json::value::RawValue;

/// What is said there.
const FRONT: &str = r#"{"texir_emission":"front"}"#;

/// The extras of such a material.
pub(super) fn extras() -> Extras {
    RawValue::from_string(FRONT.to_owned()).ok()
}

/// Whether the extras of a material say so, among other things.
pub(crate) fn emits_from_front_alone(extras: &Extras) -> bool {
    let says = |extras: &RawValue| {
        serde_json::from_str::<Value>(extras.get()).is_ok_and(|extras| extras["texir_emission"] == "front")
    };
    extras.as_deref().is_some_and(says)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extras_of_others_do_not_say_so() {
        assert!(emits_from_front_alone(&extras()));
        let of = |json: &str| Some(RawValue::from_string(json.to_owned()).unwrap());
        assert!(emits_from_front_alone(&of(r#"{ "artist": [1], "texir_emission": "front" }"#)));
        for other in [None, of("3"), of("[]"), of(r#"{ "texir_emission": true }"#), of(r#""texir_emission""#)] {
            assert!(!emits_from_front_alone(&other), "{other:?}");
        }
    }
}
