// How far a picture of two independent halves is from its mean: one invocation and one sum a column of `rows` pixels.
// A pixel's error is half the difference of the halves' means, squared; relative to the square of the radiance averaged over
// 3x3 pixels, because that of one noisy pixel is too large where its samples happen to be bright, and hides their error.
#version 460
layout(local_size_x = 64) in;

layout(set = 0, binding = 0, std430) readonly buffer Radiance { vec4 radiance[]; };     // w: 1 where the pixel is exact
layout(set = 0, binding = 1, std430) readonly buffer Difference { vec4 difference[]; }; // sum of even samples less odd ones
layout(set = 0, binding = 2, std430) writeonly buffer Sums { float sums[]; };

layout(push_constant) uniform Push {
    uint width;
    uint height; // rows of the bindings
    uint sample_count;
    uint rows;
    uint first_sum;
};

// Around a pixel that is not exact; exact ones are another surface or none and do not count.
vec3 neighbourhood(uint x, uint y) {
    vec4 sum = vec4(0.0);
    for (uint v = max(y, 1u) - 1u; v <= min(y + 1u, height - 1u); ++v) {
        for (uint u = max(x, 1u) - 1u; u <= min(x + 1u, width - 1u); ++u) {
            vec4 near = radiance[v * width + u];
            if (near.w == 0.0) sum += vec4(near.rgb, 1.0);
        }
    }
    return sum.rgb / sum.w;
}

void main() {
    uint column = gl_GlobalInvocationID.x;
    uint x = column % width;
    uint begin = column / width * rows;
    if (begin >= height) return;
    float sum = 0.0;
    for (uint y = begin; y < min(begin + rows, height); ++y) {
        if (radiance[y * width + x].w != 0.0) continue;
        vec3 error = difference[y * width + x].rgb / float(sample_count);
        vec3 mean = neighbourhood(x, y);
        vec3 relative = error * error / (mean * mean + 0.01);
        sum += (relative.r + relative.g + relative.b) / 3.0;
    }
    sums[first_sum + column] = sum;
}
