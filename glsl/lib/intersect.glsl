// Ray against one primitive. Directions are unit vectors, coordinates are scene-relative (see src/render/pack.rs).
#ifndef LIMPID_INTERSECT_GLSL
#define LIMPID_INTERSECT_GLSL

// The discriminant from the perpendicular residual (Haines et al., Ray Tracing Gems, ch. 7): no cancellation for far spheres.
// Returns (b, disc): the roots are b -+ sqrt(disc), none where disc < 0. sphere = centre, radius.
vec2 sphere_roots(vec3 o, vec3 d, vec4 sphere) {
    vec3 f = o - sphere.xyz;
    float b = -dot(f, d);
    vec3 residual = f + b * d;
    return vec2(b, sphere.w * sphere.w - dot(residual, residual));
}

// Distance to the sphere, or -1. `both`: also the far side, for origins inside.
float hit_sphere(vec3 o, vec3 d, vec4 sphere, bool both) {
    vec2 r = sphere_roots(o, d, sphere);
    float root = sqrt(max(r.y, 0.0));
    float t = r.x - root;
    if (both) t = t > 0.0 ? t : r.x + root;
    return r.y > 0.0 ? t : -1.0;
}

// Does the sphere lie between the origin and t_max? Without a square root where the origin is known to be outside.
bool blocks_sphere(vec3 o, vec3 d, float t_max, vec4 sphere, bool both) {
    vec2 r = sphere_roots(o, d, sphere);
    if (both) {
        float root = sqrt(max(r.y, 0.0));
        float near = r.x - root;
        float t = near > 0.0 ? near : r.x + root;
        return r.y > 0.0 && t > 0.0 && t < t_max;
    }
    float beyond = r.x - t_max;
    return r.y > 0.0 && r.x > 0.0 && (beyond < 0.0 || beyond * beyond < r.y);
}

// A rectangle across one axis: centre and half extents (slightly enlarged, so that touching rectangles leave no gap).
float hit_aligned(vec3 o, vec3 d, vec3 reciprocal, uint axis, vec3 center, vec3 extent) {
    vec3 f = o - center;
    float t;
    bool inside;
    if (axis == 0u) {
        t = -f.x * reciprocal.x;
        inside = abs(f.y + t * d.y) <= extent.y && abs(f.z + t * d.z) <= extent.z;
    } else if (axis == 1u) {
        t = -f.y * reciprocal.y;
        inside = abs(f.x + t * d.x) <= extent.x && abs(f.z + t * d.z) <= extent.z;
    } else {
        t = -f.z * reciprocal.z;
        inside = abs(f.x + t * d.x) <= extent.x && abs(f.y + t * d.y) <= extent.y;
    }
    return inside ? t : -1.0;
}

// Any plane: the distance, and where the ray meets it along the dual edge vectors u, v (u . half_u = 1).
vec3 hit_plane(vec3 o, vec3 d, vec3 center, vec3 normal, vec3 u, vec3 v) {
    vec3 f = o - center;
    float t = -dot(f, normal) / dot(d, normal);
    vec3 q = f + t * d;
    return vec3(t, dot(q, u), dot(q, v));
}

// Any rectangle, with the enlarged limits in w.
float hit_rectangle(vec3 o, vec3 d, vec3 center, vec3 normal, vec4 u, vec4 v) {
    vec3 hit = hit_plane(o, d, center, normal, u.xyz, v.xyz);
    return abs(hit.y) <= u.w && abs(hit.z) <= v.w ? hit.x : -1.0;
}

// The same of the ellipse in the middle of the rectangle.
float hit_disk(vec3 o, vec3 d, vec3 center, vec3 normal, vec3 u, vec3 v) {
    vec3 hit = hit_plane(o, d, center, normal, u, v);
    return hit.y * hit.y + hit.z * hit.z <= 1.0 ? hit.x : -1.0;
}

#endif
