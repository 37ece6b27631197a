// Shadow rays of scenes where some triangles let the same share of light through all over: what stops a ray or lets it
// pass in a pattern of parts would be seen in a shadow with sharp edges.

#import bvh

// Such triangles, one behind the other, that a ray goes through at most; what is behind more is dark.
const MOST_SHEETS: u32 = 32u;

// The share of light that passes from 0 < t < t_max along the unit direction; of sheets in one place, by one of them.
fn transmittance(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    let size = max(max(abs(origin.x), abs(origin.y)), abs(origin.z));
    var share = 1.0;
    var t = 0.0;
    for (var sheets = 0u; sheets <= MOST_SHEETS; sheets += 1u) {
        let hit = trace(origin, direction, t, t_max, false, true);
        if hit.primitive == MISS {
            return share;
        }
        share *= 1.0 - even_opacity(triangle_word(hit.primitive * 4u).w);
        if share == 0.0 {
            return 0.0;
        }
        // Beyond those in the same place, whose distances round apart.
        t = hit.t + BACK_FACE_BIAS * (hit.t + size);
    }
    return 0.0;
}
