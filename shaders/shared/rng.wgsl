// Low-discrepancy numbers: integer arithmetic only, the same samples as texir-core's rng.rs.

// PCG-style hash of one word (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 2020).
fn hash(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Hash of two words.
fn hash2(a: u32, b: u32) -> u32 {
    let h = hash(b);
    return hash(a ^ ((h << 16u) | (h >> 16u)));
}

// Hash-based Owen scrambling of a bit-reversed number (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020, with
// the constants of Vegdahl's improved Laine–Karras permutation).
fn laine_karras(bits: u32, seed: u32) -> u32 {
    var x = bits;
    x ^= x * 0x3d20adeau;
    x += seed;
    x *= (seed >> 16u) | 1u;
    x ^= x * 0x05526c56u;
    x ^= x * 0x53a22864u;
    return x;
}

fn owen(x: u32, seed: u32) -> u32 {
    return reverseBits(laine_karras(reverseBits(x), seed));
}

// The second Sobol dimension of index i, as a 32-bit fraction: Pascal's triangle modulo 2 in five masked shifts.
fn sobol_pascal(i: u32) -> u32 {
    var x = reverseBits(i);
    x ^= (x & 0x55555555u) << 1u;
    x ^= (x & 0x33333333u) << 2u;
    x ^= (x & 0x0f0f0f0fu) << 4u;
    x ^= (x & 0x00ff00ffu) << 8u;
    x ^= (x & 0x0000ffffu) << 16u;
    return x;
}

fn to_unit(x: u32) -> f32 {
    return f32(x >> 8u) / 16777216.0;
}

// Point `index` of the lattice sequence, shifted by `offset` (32-bit fractions), in [0, 1)².
fn lattice2(index: u32, offset: vec2u) -> vec2f {
    let x = reverseBits(index) * vec2u(1u, 38695u) + offset;
    return vec2f(to_unit(x.x), to_unit(x.y));
}

// Cells along an edge of a square that scrambled_morton goes through.
const MORTON_SIDE: u32 = 32u;

// How many cells of a square of MORTON_SIDE² a Z curve passes before it comes to that in a column and a row: their bits by
// turns, and at every level the halves in an order of their own.
fn scrambled_morton(cell: vec2u, seed: u32) -> u32 {
    var v = (cell | (cell << vec2u(4u))) & vec2u(0x0f0fu);
    v = (v | (v << vec2u(2u))) & vec2u(0x3333u);
    v = (v | (v << vec2u(1u))) & vec2u(0x5555u);
    return owen((v.x | (v.y << 1u)) << 22u, seed) >> 22u;
}

// Sample `index` of the two-dimensional Owen-scrambled Sobol sequence of `seed`, in [0, 1)².
fn sobol2(index: u32, seed: u32) -> vec2f {
    let shuffled = owen(index, seed);
    let x = owen(reverseBits(shuffled), hash2(seed, 1u));
    let y = owen(sobol_pascal(shuffled), hash2(seed, 2u));
    return vec2f(to_unit(x), to_unit(y));
}
