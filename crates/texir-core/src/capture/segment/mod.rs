//! Semantic ids by a segmentation model of the user's own, an ONNX file: `texir import --segment`.
//!
//! The model takes an image, 1×3×height×width, as photos are: 8-bit sRGB, as [0, 1] less ImageNet's mean and divided by
//! its standard deviation. It gives a score for each class (1×classes×h×w) or the index of the best one (1×h×w,
//! 1×1×h×w), at any resolution; classes are in the order of their list.
//!
//! Needs the feature `onnx`; without it, [`Segmenter::open`] says so.

#[cfg(not(feature = "onnx"))]
mod absent;
#[cfg(feature = "onnx")]
mod crop;
#[cfg(feature = "onnx")]
mod network;
#[cfg(feature = "onnx")]
mod segmenter;
#[cfg(feature = "onnx")]
mod votes;

#[cfg(not(feature = "onnx"))]
pub use self::absent::Segmenter;
#[cfg(feature = "onnx")]
pub use self::segmenter::Segmenter;

#[cfg(all(test, feature = "onnx"))]
mod tests;
