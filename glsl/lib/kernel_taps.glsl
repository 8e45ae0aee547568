// The taps of a kernel-predicting network's filter: 5x5 noisy pixels, then, but at the coarsest level, 3x3 of the next coarser one.
const uint FINE_TAPS = 25;
const uint ALL_TAPS = 34;

// Quadratic B-spline, in two dimensions, of the way from pixel `p` to its coarser pixel and `step` (-1 to 1) of them on: a pixel's middle is
// a quarter of the coarser pixel away from that one's. Without it a network, which does not see whether a pixel is even, makes steps of 2x2.
float spline(ivec2 p, ivec2 step) {
    const ivec2 away = (2 * (p & 1) - 1) * step;  // 1: on the side that the pixel lies on
    const vec2 along = mix(mix(vec2(1.0), vec2(9.0), equal(away, ivec2(1))), vec2(22.0), equal(away, ivec2(0)));
    return along.x * along.y / 1024.0;
}
