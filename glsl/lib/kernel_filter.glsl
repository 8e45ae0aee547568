// What the filter of a kernel-predicting network reads: logits [n][h][c4][w], noisy pixels [n][h][w] and, where COARSE, the next coarser
// level [n][h/2][w/2]; w of a pixel is not 0 inside the picture. The shader declares these buffers, COARSE, `height` and `width`.
#include "lib/kernel_taps.glsl"

const uint TAPS = COARSE ? ALL_TAPS : FINE_TAPS;
const uint LOGIT_TEXELS = (TAPS + 3) / 4;
const float NO_LOGIT = -3.402823e38;

// Tap `j` of the pixel at `p` of image `n`; w, what exp(logit) is multiplied with, is 0 where there is none.
vec4 tap_of(uint n, ivec2 p, uint j) {
    const bool far = COARSE && j >= FINE_TAPS;
    const int k = int(far ? j - FINE_TAPS : j);
    const int side = far ? 3 : 5;
    const ivec2 size = far ? ivec2(width, height) / 2 : ivec2(width, height);
    const ivec2 q = (far ? p / 2 : p) + ivec2(k % side, k / side) - side / 2;
    if (j >= TAPS || any(lessThan(q, ivec2(0))) || any(greaterThanEqual(q, size))) return vec4(0.0);
    const int at = (int(n) * size.y + q.y) * size.x + q.x;
    const vec4 tap = far ? imageLoad(coarse, at) : imageLoad(fine, at);
    return vec4(tap.rgb, tap.w == 0.0 ? 0.0 : far ? spline(p, q - p / 2) : 1.0);
}

// The largest logit of the taps inside, the sum of w * exp(logit - largest) over them, and, as a mean with these weights, their colour.
struct Mean {
    vec3 color;
    float largest;
    float sum;
};

Mean weighted_mean(uint n, ivec2 p, int first_logit) {
    Mean mean = Mean(vec3(0.0), NO_LOGIT, 0.0);
    for (uint t = 0; t < LOGIT_TEXELS; ++t) {
        const vec4 a = tap_of(n, p, 4 * t);
        const vec4 b = tap_of(n, p, 4 * t + 1);
        const vec4 c = tap_of(n, p, 4 * t + 2);
        const vec4 d = tap_of(n, p, 4 * t + 3);
        const vec4 factor = vec4(a.w, b.w, c.w, d.w);
        const bvec4 inside = notEqual(factor, vec4(0.0));
        const vec4 logits = mix(vec4(NO_LOGIT), imageLoad(logit, first_logit + int(t) * int(width)), inside);
        const float largest = max(max(max(logits.x, logits.y), max(logits.z, logits.w)), mean.largest);
        const vec4 e = factor * mix(vec4(0.0), exp(logits - largest), inside);
        const float scale = exp(mean.largest - largest);
        mean.color = scale * mean.color + ((e.x * a.rgb + e.y * b.rgb) + (e.z * c.rgb + e.w * d.rgb));
        mean.sum = scale * mean.sum + ((e.x + e.y) + (e.z + e.w));
        mean.largest = largest;
    }
    mean.color = mean.sum > 0.0 ? mean.color / mean.sum : vec3(0.0);
    return mean;
}
