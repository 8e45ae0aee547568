#version 460
// Halves the loss scale after a skipped step, doubles it after a row of good ones, and clears `skip`. One invocation works.

layout(local_size_x = 1) in;

layout(set = 0, binding = 0, std430) buffer LossScale { float loss_scale; uint good_steps; };
layout(set = 0, binding = 1, std430) buffer Skip { uint skip[]; };

layout(push_constant) uniform Push {
    uint growth_interval;  // good steps before the scale is doubled
    float largest;
};

void main() {
    if (skip[0] != 0) {
        loss_scale = max(loss_scale * 0.5, 1.0);
        good_steps = 0;
    } else if (++good_steps >= growth_interval) {
        loss_scale = min(loss_scale * 2.0, largest);
        good_steps = 0;
    }
    skip[0] = 0;
}
