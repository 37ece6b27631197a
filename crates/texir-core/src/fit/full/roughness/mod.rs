//! From what pixels cost at each roughness to the roughness of every texel.

pub mod blocks;
pub mod confidence;
pub mod cross_validation;
pub mod evidence;
pub mod finishes;
pub mod hierarchy;
pub mod metals;
mod nodes;
pub mod prior;
pub mod scan;
pub mod similarity_prior;
pub mod variation;
