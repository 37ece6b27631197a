//! Image loss, twin of `radiance_loss.wgsl`.

use crate::real::{Real, V3};

/// One pixel's share of the mean of |T(rendered) − T(target)| and its gradient with respect to `rendered`; T(x) =
/// ln(1+x), `share` is one over three times the number of pixels.
pub fn radiance_loss<R: Real>(rendered: V3<R>, target: V3<R>, share: R) -> (R, V3<R>) {
    let mut loss = R::of(0.0);
    let gradient = V3(std::array::from_fn(|c| {
        let (a, b) = (rendered.0[c], target.0[c]);
        loss = loss + (a.ln_1p() - b.ln_1p()).abs() * share;
        // T rises, so that the difference of T has the sign of a − b, free of the logarithm's rounding.
        let sign = if a > b {
            share
        } else if a < b {
            -share
        } else {
            R::of(0.0)
        };
        sign / (R::of(1.0) + a)
    }));
    (loss, gradient)
}
