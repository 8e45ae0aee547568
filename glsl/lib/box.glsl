// Rectangles that are the sides of a box with the whole scene in it; one side may be missing, and the camera looks in there.
// Included by lib/scene.glsl. Every ray begins in the box or before the missing side, so it meets only the three sides that it runs toward
// (src/render/enclosure.rs), and of these the nearest.
#ifndef LIMPID_BOX_GLSL
#define LIMPID_BOX_GLSL

// Five bits a side, low x, y, z, then high: the rectangle's number from 1 on, 0 for the missing one.
uint side(uint s) { return (BOX_SIDES >> (5u * s)) & 31u; }

const bool BOXED = PRELOAD && BOX_SIDES != 0u;

bool is_side(uint rect) {
    bool found = false;
    [[unroll]] for (uint s = 0u; s < 6u; ++s) found = found || side(s) == rect + 1u;
    return BOXED && found;
}

// Has the scene no other rectangle?
bool only_sides() {
    bool all = BOXED;
    [[unroll]] for (uint i = 0u; BOXED && i < RECT_COUNT; ++i) all = all && is_side(i);
    return all;
}

// A side across another axis than `a`: their extents along `a` are the same.
uint beside(uint a) { return max(side((a + 1u) % 3u), side((a + 1u) % 3u + 3u)) - 1u; }

float to_side(uint s, vec3 o, vec3 reciprocal) {
    uint a = s % 3u;
    return side(s) == 0u ? 2e30 : -(o[a] - g_center[side(s) - 1u][a]) * reciprocal[a];
}

// The hit of a side, if it is closer than `best`. Of equally close rectangles the first one counts, as without a box. A surface that
// touches a side may have points that were moved beyond that: from there nothing is met, for that side's black back is in the way.
void leave_box(vec3 o, vec3 d, vec3 reciprocal, uint skip, inout float best, inout uint id) {
    float t = 2e30;
    uint wall = 0u;
    bool inside = true, beyond = false;
    [[unroll]] for (uint a = 0u; a < 3u; ++a) {
        bool back = reciprocal[a] < 0.0;
        float to = back ? to_side(a, o, reciprocal) : to_side(a + 3u, o, reciprocal);
        uint i = back ? side(a) : side(a + 3u);
        bool closer = to < t || to == t && i < wall;
        t = closer ? to : t;
        wall = closer ? i : wall;
    }
    [[unroll]] for (uint a = 0u; a < 3u; ++a) {
        // Through the missing side?
        if (side(a) != 0u && side(a + 3u) != 0u) continue;
        inside = abs(o[a] - g_center[beside(a)][a] + t * d[a]) <= g_extent[beside(a)][a];
    }
    [[unroll]] for (uint s = 0u; s < 6u; ++s) {
        if (side(s) == 0u) continue;
        float plane = g_center[side(s) - 1u][s % 3u];
        beyond = beyond || !(s < 3u ? o[s % 3u] > plane : o[s % 3u] < plane);
    }
    wall += SPHERE_COUNT - 1u;
    bool closer = inside && (t < best || t == best && wall < id) && wall != skip;
    best = beyond ? 0.0 : closer ? t : best;
    id = beyond ? NONE : closer ? wall : id;
}

// The hit `p` of side v.id, pulled back onto it and off its edges.
Vertex box_vertex(Vertex v, vec3 p) {
    [[unroll]] for (uint a = 0u; a < 3u; ++a) {
        float center = g_center[beside(a)][a], inner = g_inner[beside(a)][a];
        v.p[a] = clamp(p[a], center - inner, center + inner);
    }
    v.n = vec3(0.0);
    v.albedo = vec3(0.0);
    [[unroll]] for (uint s = 0u; s < 6u; ++s) {
        uint i = side(s) - 1u, a = s % 3u;
        if (side(s) == 0u) continue;
        bool mine = v.id == SPHERE_COUNT + i;
        v.p[a] = mine ? g_center[i][a] : v.p[a];
        v.n[a] = mine ? g_normal[i][a] : v.n[a];
        v.albedo = mine ? g_rect_albedo[i] : v.albedo;
    }
    return v;
}

#endif
