//! Checks of single settings.

/// A setting's name, its value, whether it is allowed, and what is.
pub type Check = (&'static str, f32, bool, &'static str);

pub fn not_negative(name: &'static str, value: f32) -> Check {
    (name, value, value >= 0.0 && value.is_finite(), "at least 0")
}

pub fn positive(name: &'static str, value: f32) -> Check {
    (name, value, value > 0.0 && value.is_finite(), "above 0")
}

pub fn counts(name: &'static str, value: u32) -> Check {
    (name, value as f32, (1..=1024).contains(&value), "1 to 1024")
}

pub fn at_least_one(name: &'static str, value: u32) -> Check {
    (name, value as f32, value > 0, "at least 1")
}

pub fn share(name: &'static str, value: f32) -> Check {
    (name, value, (0.0..=1.0).contains(&value), "in [0, 1]")
}

pub fn roughness(name: &'static str, value: f32) -> Check {
    (name, value, (0.03..=1.0).contains(&value), "in [0.03, 1]")
}
