//! Clusters of light triangles: those that are near each other and face the same way are seen, or hidden, together.

use glam::Vec3;

use crate::mesh::{Mesh, bounds};
use crate::surface::facing;

/// Most clusters of a scene. Fewer make a table a worse fit; more cost memory and shadow rays, and leave each too few
/// samples to spread well (docs/irradiance.md).
const CLUSTERS: usize = 256;

/// Splits the triangles by facing, then at half of the power along the longest axis, the cluster of greatest power ×
/// extent first. Within a cluster, neighbours in the list are neighbours in space.
pub fn clusters(mesh: &Mesh, triangles: Vec<u32>, power: &impl Fn(u32) -> f32) -> Vec<Vec<u32>> {
    let mut clusters = vec![Vec::new(); 6];
    triangles.into_iter().for_each(|t| clusters[facing(mesh.face_normal(t))].push(t));
    clusters.retain(|c| !c.is_empty());
    let total = |cluster: &[u32]| cluster.iter().map(|&t| f64::from(power(t))).sum::<f64>();
    let spread = |cluster: &[u32]| {
        if cluster.len() > 1 { total(cluster) as f32 * extent(mesh, cluster).length() } else { 0.0 }
    };
    let mut spreads: Vec<f32> = clusters.iter().map(|c| spread(c)).collect();
    while clusters.len() < CLUSTERS {
        let Some((widest, _)) = spreads.iter().enumerate().filter(|(_, s)| **s > 0.0).max_by(|a, b| a.1.total_cmp(b.1))
        else {
            break;
        };
        sort_along_longest(mesh, &mut clusters[widest]);
        let half = total(&clusters[widest]) / 2.0;
        let mut sum = 0.0;
        let reaches_half = |&t: &u32| {
            sum += f64::from(power(t));
            sum >= half
        };
        let last = clusters[widest].len() - 1;
        let at = clusters[widest].iter().position(reaches_half).unwrap_or(last).clamp(1, last);
        let other = clusters[widest].split_off(at);
        spreads[widest] = spread(&clusters[widest]);
        spreads.push(spread(&other));
        clusters.push(other);
    }
    clusters.iter_mut().for_each(|c| order(mesh, c));
    clusters
}

/// Halves along the longest axis, halves of halves, and so on.
fn order(mesh: &Mesh, triangles: &mut [u32]) {
    if triangles.len() > 2 {
        sort_along_longest(mesh, triangles);
        let (left, right) = triangles.split_at_mut(triangles.len() / 2);
        order(mesh, left);
        order(mesh, right);
    }
}

fn sort_along_longest(mesh: &Mesh, triangles: &mut [u32]) {
    let axis = extent(mesh, triangles).max_position();
    triangles.sort_by(|&a, &b| mesh.centre(a)[axis].total_cmp(&mesh.centre(b)[axis]));
}

/// Edges of the bounding box.
fn extent(mesh: &Mesh, triangles: &[u32]) -> Vec3 {
    let (low, high) = bounds(triangles.iter().flat_map(|&t| mesh.corners(t)));
    high - low
}
