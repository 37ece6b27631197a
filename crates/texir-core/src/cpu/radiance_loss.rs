//! Image loss, twin of `radiance_loss.wgsl`.

use crate::real::{Real, V3};

/// One pixel's share of the mean of |T(rendered) − T(target)| and its gradient with respect to `rendered`; T(x) =
/// ln(1+x), `share` is one over three times the number of pixels.
pub fn radiance_loss<R: Real>(rendered: V3<R>, target: V3<R>, share: R) -> (R, V3<R>) {
    let zero = R::of(0.0);
    let mut loss = zero;
    let gradient = V3(std::array::from_fn(|c| {
        let difference = rendered.0[c].ln_1p() - target.0[c].ln_1p();
        loss = loss + difference.abs() * share;
        let sign = if difference > zero {
            share
        } else if difference < zero {
            -share
        } else {
            zero
        };
        sign / (R::of(1.0) + rendered.0[c])
    }));
    (loss, gradient)
}
