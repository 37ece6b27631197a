//! Clusters of lights: those that are near each other and face the same way are seen, or hidden, together.

use glam::Vec3;

use crate::mesh::bounds;

/// Most clusters of a scene. Fewer make a table a worse fit; more cost memory and shadow rays, and leave each too few
/// samples to spread well (docs/irradiance.md).
const CLUSTERS: usize = 256;

/// What is to be clustered.
pub struct Shining {
    pub corners: [Vec3; 3],
    /// Which of the six ways of [`crate::surface::facing`].
    pub facing: usize,
    pub power: f32,
}

/// Splits the lights by facing, then at half of the power along the longest axis, the cluster of greatest power ×
/// extent first. Within a cluster, neighbours in the list are neighbours in space.
pub fn clusters(lights: &[Shining]) -> Vec<Vec<u32>> {
    let mut clusters = vec![Vec::new(); 6];
    (0..).zip(lights).for_each(|(index, light)| clusters[light.facing].push(index));
    clusters.retain(|c| !c.is_empty());
    let power = |index: &u32| f64::from(lights[*index as usize].power);
    let total = |cluster: &[u32]| cluster.iter().map(power).sum::<f64>();
    let spread = |cluster: &[u32]| {
        if cluster.len() > 1 { total(cluster) as f32 * extent(lights, cluster).length() } else { 0.0 }
    };
    let mut spreads: Vec<f32> = clusters.iter().map(|c| spread(c)).collect();
    while clusters.len() < CLUSTERS {
        let Some((widest, _)) = spreads.iter().enumerate().filter(|(_, s)| **s > 0.0).max_by(|a, b| a.1.total_cmp(b.1))
        else {
            break;
        };
        sort_along_longest(lights, &mut clusters[widest]);
        let half = total(&clusters[widest]) / 2.0;
        let mut sum = 0.0;
        let reaches_half = |index: &u32| {
            sum += power(index);
            sum >= half
        };
        let last = clusters[widest].len() - 1;
        let at = clusters[widest].iter().position(reaches_half).unwrap_or(last).clamp(1, last);
        let other = clusters[widest].split_off(at);
        spreads[widest] = spread(&clusters[widest]);
        spreads.push(spread(&other));
        clusters.push(other);
    }
    clusters.iter_mut().for_each(|c| order(lights, c));
    clusters
}

/// Halves along the longest axis, halves of halves, and so on.
fn order(lights: &[Shining], cluster: &mut [u32]) {
    if cluster.len() > 2 {
        sort_along_longest(lights, cluster);
        let (left, right) = cluster.split_at_mut(cluster.len() / 2);
        order(lights, left);
        order(lights, right);
    }
}

fn sort_along_longest(lights: &[Shining], cluster: &mut [u32]) {
    let axis = extent(lights, cluster).max_position();
    let centre = |index: u32| lights[index as usize].corners.iter().map(|corner| corner[axis]).sum::<f32>();
    cluster.sort_by(|&a, &b| centre(a).total_cmp(&centre(b)));
}

/// Edges of the bounding box.
fn extent(lights: &[Shining], cluster: &[u32]) -> Vec3 {
    let (low, high) = bounds(cluster.iter().flat_map(|&index| lights[index as usize].corners));
    high - low
}
