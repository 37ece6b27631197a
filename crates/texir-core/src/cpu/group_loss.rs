//! Smoothness over groups of pixels, twin of `group_loss.wgsl`.

use crate::backend::{GroupTarget, Groups};
use crate::real::Real;

/// The mean over all grouped pixels and channels of |value − target_g|; the gradient is added to `d_values`. Returns
/// the loss.
///
/// With [`GroupTarget::Mean`] the gradient flows through the mean: (sign_i − mean sign)/N. With
/// [`GroupTarget::Quantile`] the target is fixed and only the members that are no references are drawn to it.
pub fn group_loss<R: Real>(
    values: &[R],
    channels: usize,
    groups: &Groups,
    target: GroupTarget,
    d_values: &mut [R],
) -> R {
    let share = R::of(1.0 / (groups.members.len() * channels).max(1) as f64);
    let mut loss = R::of(0.0);
    for (g, bounds) in groups.offsets.windows(2).enumerate() {
        let members = &groups.members[bounds[0] as usize..bounds[1] as usize];
        let (references, others) = members.split_at(groups.references[g] as usize);
        for c in 0..channels {
            let value = |&pixel: &u32| values[pixel as usize * channels + c];
            let (aim, drawn) = match target {
                GroupTarget::Mean => (mean(members.iter().map(value)), members),
                GroupTarget::Quantile(_) if references.is_empty() => continue,
                GroupTarget::Quantile(q) => (quantile(references.iter().map(value).collect(), q), others),
            };
            if drawn.is_empty() {
                continue;
            }
            let sign = |v: R| {
                R::of(if v > aim {
                    1.0
                } else if v < aim {
                    -1.0
                } else {
                    0.0
                })
            };
            let through_aim = match target {
                GroupTarget::Mean => mean(drawn.iter().map(|p| sign(value(p)))),
                GroupTarget::Quantile(_) => R::of(0.0),
            };
            loss = loss + sum(drawn.iter().map(|pixel| (value(pixel) - aim).abs() * share));
            for pixel in drawn {
                let d = &mut d_values[*pixel as usize * channels + c];
                *d = *d + (sign(value(pixel)) - through_aim) * share;
            }
        }
    }
    loss
}

fn mean<R: Real>(values: impl ExactSizeIterator<Item = R>) -> R {
    let count = values.len();
    sum(values) * R::of(1.0 / count as f64)
}

/// Block by block: a running sum of millions of items in single precision stops.
fn sum<R: Real>(values: impl Iterator<Item = R>) -> R {
    const BLOCK: usize = 4096;
    let (mut all, mut block) = (R::of(0.0), R::of(0.0));
    for (i, value) in values.enumerate() {
        if i % BLOCK == 0 {
            (all, block) = (all + block, R::of(0.0));
        }
        block = block + value;
    }
    all + block
}

/// The q-quantile with linear interpolation between order statistics, at position q(n−1).
fn quantile<R: Real>(mut values: Vec<R>, q: f32) -> R {
    values.sort_by(|a, b| a.value().total_cmp(&b.value()));
    let position = f64::from(q) * (values.len() - 1) as f64;
    let (low, f) = (position.floor() as usize, position.fract());
    let high = (low + 1).min(values.len() - 1);
    values[low] + (values[high] - values[low]) * R::of(f)
}
