// The path tracer: one invocation a pixel, one flat loop in which a finished path is replaced by the next sample's at once.
// An iteration: light sampling at the current vertex, one new direction, one closest-hit query.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/random.glsl"
#include "lib/sampling.glsl"
#include "lib/intersect.glsl"

layout(local_size_x = 8, local_size_y = 8) in;

// What the scene and the settings need; the rest does not exist in the pipeline (src/render/features.rs).
layout(constant_id = 0) const uint SPHERE_COUNT = 5;
layout(constant_id = 1) const uint RECT_COUNT = 5;
layout(constant_id = 2) const uint SPHERE_LIGHT_COUNT = 1; // lit from outside; the first spheres
layout(constant_id = 3) const uint RECT_LIGHT_COUNT = 0;   // the first rectangles
layout(constant_id = 4) const uint INWARD_FIRST = 5;       // spheres from here on point inward
layout(constant_id = 5) const uint INWARD_LIGHT_COUNT = 0; // the first inward spheres
layout(constant_id = 6) const uint RECT_AXES = 0;          // two bits a rectangle: 0 any, 1 x, 2 y, 3 z
layout(constant_id = 7) const uint RECT_BLOCKERS = 0xffffffff; // one bit a rectangle: can it cast a shadow?
layout(constant_id = 8) const bool PRELOAD = true;         // few primitives: hold them in registers
layout(constant_id = 9) const bool CAMERA_INSIDE = false;  // the camera is inside an outward sphere
layout(constant_id = 10) const uint ESTIMATOR = 2;
layout(constant_id = 11) const uint SAMPLER = 1;
layout(constant_id = 12) const uint BOUNCES = 8;
layout(constant_id = 13) const bool ANTIALIAS = false;
layout(constant_id = 14) const bool VARIANCE = false;

const uint ESTIMATOR_UNIFORM = 0u;
const uint ESTIMATOR_COSINE = 1u;
const uint ESTIMATOR_NEE = 2u;

// Rows: camera (4), then PRIMITIVE_ROWS a primitive, spheres first (src/render/pack.rs).
layout(set = 0, binding = 0, rgba32f) readonly uniform imageBuffer scene;
// Sums of whole blocks of 64 samples and of the block begun; total.w = 1 marks an exact pixel.
layout(set = 0, binding = 1, std430) buffer Total { vec4 total[]; };
layout(set = 0, binding = 2, std430) buffer Block { vec4 block[]; };
// Rays, samples, invalid samples, samples that were not exact.
layout(set = 0, binding = 3, std430) buffer Counts { uvec4 counts[]; };
// First hits; with ANTIALIAS sums over the samples.
layout(set = 0, binding = 4, std430) buffer Albedo { vec4 aov_albedo[]; };
layout(set = 0, binding = 5, std430) buffer NormalWorld { vec4 aov_normal[]; };
layout(set = 0, binding = 6, std430) buffer Screen { vec4 aov_screen[]; };
// A pixel's batch sum, mean of batch means and their sum of squared deviations, one after another.
layout(set = 0, binding = 7, std430) buffer Batch { vec4 batch[]; };

layout(push_constant) uniform Push {
    uint width;
    uint height;
    uint window_row; // the buffers begin at this row
    uint row_begin;
    uint row_end;
    uint sample_begin;
    uint sample_end;
    uint seed;
    uint batch_size;
    uint write_aov;
};

const uint NONE = 0xffffffffu;
const uint BLOCK_SIZE = 64u;
const int CAMERA_ROWS = 4;
const int PRIMITIVE_ROWS = 10;
const uint LIGHT_COUNT = SPHERE_LIGHT_COUNT + RECT_LIGHT_COUNT;
const bool NEE = ESTIMATOR == ESTIMATOR_NEE && LIGHT_COUNT > 0u;
// Does a ray after the last reflection's light sample still find light?
const bool LAST_RAY = !NEE || RECT_LIGHT_COUNT > 0u || INWARD_LIGHT_COUNT > 0u;
const bool LIT = LIGHT_COUNT + INWARD_LIGHT_COUNT > 0u;
const bool ONE_LIGHT = LIGHT_COUNT + INWARD_LIGHT_COUNT == 1u;
const uint ONE_LIGHT_ID = SPHERE_LIGHT_COUNT > 0u ? 0u : INWARD_LIGHT_COUNT > 0u ? INWARD_FIRST : SPHERE_COUNT;
// All rectangles across an axis?
const uint AXIS_BITS = RECT_COUNT >= 16u ? 0x55555555u : ((1u << (2u * RECT_COUNT)) - 1u) & 0x55555555u;
const bool ALIGNED = PRELOAD && ((RECT_AXES | (RECT_AXES >> 1u)) & AXIS_BITS) == AXIS_BITS;

vec4 row(uint id, int k) { return imageLoad(scene, CAMERA_ROWS + int(id) * PRIMITIVE_ROWS + k); }

// Rows of a primitive.
const int GEOMETRY = 0; // centre, radius (rectangle: area)
const int ALBEDO = 1;   // w: 1 for an inward sphere
const int RADIANCE = 2; // w: upper end of the light's share in the choice of lights
const int NORMAL = 3;   // rectangles only from here
const int DUAL_U = 4;
const int DUAL_V = 5;
const int HALF_U = 6;   // w: limit to which a hit is pulled inside
const int HALF_V = 7;
const int EXTENT = 8;   // across an axis: half extents, enlarged
const int INNER = 9;    // across an axis: half extents to which a hit is pulled inside

const uint SPHERES = SPHERE_COUNT > 0u ? SPHERE_COUNT : 1u;
const uint RECTS = RECT_COUNT > 0u ? RECT_COUNT : 1u;
vec4 g_sphere[SPHERES];
vec3 g_sphere_albedo[SPHERES];
vec3 g_center[RECTS];
vec3 g_extent[RECTS];
vec3 g_inner[RECTS];
vec3 g_normal[RECTS];
vec3 g_rect_albedo[RECTS];
vec4 g_light;
vec3 g_light_radiance;
vec3 g_right;
vec3 g_up;
vec3 g_forward;

uint rect_axis(uint i) { return PRELOAD ? (RECT_AXES >> (2u * i)) & 3u : 0u; }
bool rect_blocks(uint i) { return !PRELOAD || ((RECT_BLOCKERS >> i) & 1u) != 0u; }

// Loads of the same address by all invocations are cheap here, before the loop, and dear inside.
void preload() {
    if (ONE_LIGHT) {
        g_light = row(ONE_LIGHT_ID, GEOMETRY);
        g_light_radiance = row(ONE_LIGHT_ID, RADIANCE).rgb;
    }
    g_right = imageLoad(scene, 1).xyz;
    g_up = imageLoad(scene, 2).xyz;
    g_forward = imageLoad(scene, 3).xyz;
    if (!PRELOAD) return;
    [[unroll]] for (uint i = 0u; i < SPHERE_COUNT; ++i) {
        g_sphere[i] = row(i, GEOMETRY);
        g_sphere_albedo[i] = row(i, ALBEDO).rgb;
    }
    [[unroll]] for (uint i = 0u; i < RECT_COUNT; ++i) {
        g_center[i] = row(SPHERE_COUNT + i, GEOMETRY).xyz;
        g_extent[i] = row(SPHERE_COUNT + i, EXTENT).xyz;
        g_inner[i] = row(SPHERE_COUNT + i, INNER).xyz;
        g_normal[i] = row(SPHERE_COUNT + i, NORMAL).xyz;
        g_rect_albedo[i] = row(SPHERE_COUNT + i, ALBEDO).rgb;
    }
}

vec4 sphere_at(uint i) { return PRELOAD ? g_sphere[i] : row(i, GEOMETRY); }

float hit_rect_at(uint i, vec3 o, vec3 d, vec3 reciprocal) {
    if (PRELOAD && rect_axis(i) != 0u) return hit_aligned(o, d, reciprocal, rect_axis(i) - 1u, g_center[i], g_extent[i]);
    uint id = SPHERE_COUNT + i;
    return hit_rectangle(o, d, row(id, GEOMETRY).xyz, row(id, NORMAL).xyz, row(id, DUAL_U), row(id, DUAL_V));
}

// A point on a surface, moved off it along the normal, and what the path needs there.
struct Vertex {
    vec3 p;
    vec3 n;
    vec3 albedo;
    uint id;
    bool front;
};

// Closest hit; `skip` is the convex primitive that the ray leaves.
uint closest_hit(vec3 o, vec3 d, uint skip, inout float best) {
    uint id = NONE;
    [[unroll]] for (uint i = 0u; i < SPHERE_COUNT; ++i) {
        bool inward = i >= INWARD_FIRST;
        float t = hit_sphere(o, d, sphere_at(i), inward || CAMERA_INSIDE);
        bool closer = t > 0.0 && t < best && (inward || i != skip);
        best = closer ? t : best;
        id = closer ? i : id;
    }
    vec3 reciprocal = 1.0 / d;
    [[unroll]] for (uint i = 0u; i < RECT_COUNT; ++i) {
        float t = hit_rect_at(i, o, d, reciprocal);
        bool closer = t > 0.0 && t < best && SPHERE_COUNT + i != skip;
        best = closer ? t : best;
        id = closer ? SPHERE_COUNT + i : id;
    }
    return id;
}

// Is anything between a surface and a light? Neither the receiver nor the light blocks: both are convex.
bool occluded(vec3 o, vec3 d, float t_max, uint receiver, uint light) {
    bool blocked = false;
    [[unroll]] for (uint i = 0u; i < SPHERE_COUNT; ++i) {
        if (LIGHT_COUNT == 1u && SPHERE_LIGHT_COUNT == 1u && i == 0u) continue;
        bool inward = i >= INWARD_FIRST;
        bool hit = blocks_sphere(o, d, t_max, sphere_at(i), inward);
        blocked = blocked || (hit && i != light && (inward || i != receiver));
    }
    vec3 reciprocal = 1.0 / d;
    [[unroll]] for (uint i = 0u; i < RECT_COUNT; ++i) {
        if (!rect_blocks(i)) continue;
        float t = hit_rect_at(i, o, d, reciprocal);
        blocked = blocked || (t > 0.0 && t < t_max && SPHERE_COUNT + i != light && SPHERE_COUNT + i != receiver);
    }
    return blocked;
}

// The hit, pulled back onto its surface: a ray's far end is less exact than the surface is.
Vertex make_vertex(vec3 p, vec3 d, uint id, float offset) {
    Vertex v;
    v.id = id;
    bool rect = RECT_COUNT > 0u && (SPHERE_COUNT == 0u || id >= SPHERE_COUNT);
    if (SPHERE_COUNT > 0u && !rect) {
        vec4 s = sphere_at(0u);
        v.albedo = g_sphere_albedo[0];
        if (PRELOAD) {
            [[unroll]] for (uint i = 1u; i < SPHERE_COUNT; ++i) {
                s = id == i ? g_sphere[i] : s;
                v.albedo = id == i ? g_sphere_albedo[i] : v.albedo;
            }
        } else {
            s = row(id, GEOMETRY);
            v.albedo = row(id, ALBEDO).rgb;
        }
        v.n = normalize(p - s.xyz);
        v.p = s.xyz + s.w * v.n;
        if (INWARD_FIRST < SPHERE_COUNT) v.n = id >= INWARD_FIRST ? -v.n : v.n;
    } else if (ALIGNED) {
        vec3 center = g_center[0], inner = g_inner[0];
        v.n = g_normal[0];
        v.albedo = g_rect_albedo[0];
        [[unroll]] for (uint i = 1u; i < RECT_COUNT; ++i) {
            bool mine = id == SPHERE_COUNT + i;
            center = mine ? g_center[i] : center;
            inner = mine ? g_inner[i] : inner;
            v.n = mine ? g_normal[i] : v.n;
            v.albedo = mine ? g_rect_albedo[i] : v.albedo;
        }
        v.p = clamp(p, center - inner, center + inner);
    } else {
        vec3 center = row(id, GEOMETRY).xyz;
        v.n = row(id, NORMAL).xyz;
        v.albedo = row(id, ALBEDO).rgb;
        vec4 half_u = row(id, HALF_U);
        vec4 half_v = row(id, HALF_V);
        vec3 f = p - center;
        float a = clamp(dot(f, row(id, DUAL_U).xyz), -half_u.w, half_u.w);
        float b = clamp(dot(f, row(id, DUAL_V).xyz), -half_v.w, half_v.w);
        v.p = center + a * half_u.xyz + b * half_v.xyz;
    }
    v.front = dot(d, v.n) < 0.0;
    v.p += offset * v.n;
    return v;
}

bool emits(uint id) {
    return id < SPHERE_LIGHT_COUNT || (id >= INWARD_FIRST && id < INWARD_FIRST + INWARD_LIGHT_COUNT)
        || (id >= SPHERE_COUNT && id < SPHERE_COUNT + RECT_LIGHT_COUNT);
}

// Light that reaches the vertex directly from one chosen light, per unit of throughput (albedo excluded).
vec3 sample_light(Vertex v, vec2 u, float choice, inout uint rays) {
    uint light = 0u;
    float share = 1.0;
    if (LIGHT_COUNT > 1u) {
        float below = 0.0;
        share = 0.0;
        for (uint i = 0u; i < LIGHT_COUNT; ++i) {
            uint id = i < SPHERE_LIGHT_COUNT ? i : SPHERE_COUNT + i - SPHERE_LIGHT_COUNT;
            float above = row(id, RADIANCE).w;
            bool chosen = choice >= below && choice < above;
            light = chosen ? id : light;
            share = chosen ? above - below : share;
            below = above;
        }
    } else if (SPHERE_LIGHT_COUNT == 0u) {
        light = SPHERE_COUNT;
    }
    if (light == v.id || share <= 0.0) return vec3(0.0);
    vec4 g = ONE_LIGHT ? g_light : row(light, GEOMETRY);
    vec3 wi;
    float t_light;
    float weight; // cos / (pi * pdf), with the balance heuristic where a bounce can find the light too
    if (RECT_LIGHT_COUNT == 0u || (SPHERE_LIGHT_COUNT > 0u && light < SPHERE_LIGHT_COUNT)) {
        vec3 to_center = g.xyz - v.p;
        float distance2 = dot(to_center, to_center);
        float s2 = g.w * g.w / distance2;
        if (!(s2 < 1.0)) return vec3(0.0); // inside: only the back of the light is seen
        float inverse = inversesqrt(distance2);
        float cone = cone_one_minus_cos(s2);
        float omc;
        wi = sample_cone(to_center * inverse, cone, u, omc);
        float sin2 = omc * (2.0 - omc);
        t_light = distance2 * inverse * ((1.0 - omc) - sqrt(max(0.0, s2 - sin2)));
        weight = dot(wi, v.n) * 2.0 * cone / share;
    } else {
        vec3 q = g.xyz + (2.0 * u.x - 1.0) * row(light, HALF_U).xyz + (2.0 * u.y - 1.0) * row(light, HALF_V).xyz - v.p;
        float distance2 = dot(q, q);
        float inverse = inversesqrt(distance2);
        wi = q * inverse;
        t_light = distance2 * inverse;
        float facing = -dot(wi, row(light, NORMAL).xyz);
        if (!(facing > 0.0) || !(distance2 > 0.0)) return vec3(0.0);
        float pdf_light = share * distance2 / (facing * g.w);
        float pdf_bounce = max(0.0, dot(wi, v.n)) / PI;
        weight = pdf_bounce / (pdf_light + pdf_bounce);
    }
    if (!(weight > 0.0)) return vec3(0.0);
    rays += 1u;
    if (occluded(v.p, wi, t_light, v.id, light)) return vec3(0.0);
    return weight * (ONE_LIGHT ? g_light_radiance : row(light, RADIANCE).rgb);
}

// Emission met by a ray; with light sampling only what that technique leaves to this one.
vec3 emission(Vertex v, vec3 d, float t, float pdf_bounce, bool camera) {
    if (!LIT || !v.front || !emits(v.id)) return vec3(0.0);
    vec4 radiance = ONE_LIGHT ? vec4(g_light_radiance, 1.0) : row(v.id, RADIANCE);
    float weight = 1.0;
    if (NEE && !camera) {
        if (v.id < SPHERE_LIGHT_COUNT) weight = 0.0;
        if (RECT_LIGHT_COUNT > 0u && v.id >= SPHERE_COUNT) {
            uint i = v.id - SPHERE_COUNT;
            float below = 0.0;
            if (i > 0u) below = row(v.id - 1u, RADIANCE).w;
            else if (SPHERE_LIGHT_COUNT > 0u) below = row(SPHERE_LIGHT_COUNT - 1u, RADIANCE).w;
            float pdf_light = (radiance.w - below) * t * t / (-dot(d, v.n) * row(v.id, GEOMETRY).w);
            weight = pdf_bounce / (pdf_bounce + pdf_light);
        }
    }
    return weight * radiance.rgb;
}

// NaN, infinite or negative: one unsigned comparison on the bits, which no compiler folds away.
bool invalid(vec3 x) { return max(floatBitsToUint(x.r), max(floatBitsToUint(x.g), floatBitsToUint(x.b))) >= 0x7f800000u; }

vec3 camera_ray(vec2 film_position) {
    vec2 film = film_position * (2.0 / vec2(width, height)) - 1.0;
    return normalize(g_forward + film.x * g_right - film.y * g_up);
}

// A new direction at the vertex; `weight` is cos / (pi * pdf).
vec3 sample_direction(Vertex v, vec2 u, out float weight, out float pdf) {
    weight = 1.0;
    if (ESTIMATOR == ESTIMATOR_UNIFORM) {
        vec3 d = sample_hemisphere(v.n, u);
        weight = 2.0 * dot(d, v.n);
        pdf = 0.5 / PI;
        return d;
    }
    vec3 d = sample_cosine(v.n, u);
    pdf = dot(d, v.n) / PI;
    return d;
}

// Screen-space normal (x right, y up, of the side that faces the camera), depth along the ray, hit.
vec4 screen_values(vec3 n, float t) {
    return vec4(dot(n, normalize(g_right)), dot(n, normalize(g_up)), t * imageLoad(scene, 1).w, 1.0);
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy + uvec2(0u, row_begin);
    if (pixel.x >= width || pixel.y >= row_end) return;
    uint index = (pixel.y - window_row) * width + pixel.x;
    vec4 sum_total = total[index];
    if (!ANTIALIAS && write_aov == 0u && sum_total.w != 0.0) return; // exact: nothing to add
    preload();
    uvec2 key = pixel_key(pixel, seed);
    vec4 origin = imageLoad(scene, 0); // w: how far a ray starts off its surface

    uint sample_index = sample_begin;
    uint depth = 0u; // reflections before the current ray
    float pdf = 0.0; // of the current ray's direction
    uint rays = 0u, bad = 0u, inexact = 0u;
    vec3 radiance = vec3(0.0), throughput = vec3(1.0), first_radiance = vec3(0.0);
    vec3 sum_albedo = vec3(0.0), sum_normal = vec3(0.0);
    vec4 sum_screen = vec4(0.0);
    vec3 o = origin.xyz, d = vec3(0.0);
    bool at_vertex = false, has_ray = ANTIALIAS;
    Vertex vertex, first;
    vertex.id = NONE;

    if (ANTIALIAS) {
        sum_albedo = aov_albedo[index].rgb;
        sum_normal = aov_normal[index].xyz;
        sum_screen = aov_screen[index];
        d = camera_ray(vec2(pixel) + random4(SAMPLER, key, sample_index, 0u).xy);
    } else {
        d = camera_ray(vec2(pixel) + 0.5);
        float t = 1e30;
        uint id = closest_hit(o, d, NONE, t);
        rays += 1u;
        bool exact = true;
        if (id != NONE) {
            first = make_vertex(o + t * d, d, id, origin.w);
            first_radiance = emission(first, d, t, 0.0, true);
            if (!first.front) first.albedo = vec3(0.0);
            exact = BOUNCES == 0u || first.albedo == vec3(0.0);
            sum_albedo = first.albedo;
            sum_normal = first.front ? first.n : -first.n;
            sum_screen = screen_values(sum_normal, t);
        }
        if (write_aov != 0u) {
            aov_albedo[index] = vec4(sum_albedo, 0.0);
            aov_normal[index] = vec4(sum_normal, 0.0);
            aov_screen[index] = sum_screen;
        }
        if (exact) {
            total[index] = vec4(first_radiance, 1.0);
            counts[index].x += rays;
            return;
        }
        vertex = first;
        radiance = first_radiance;
        throughput = first.albedo;
        at_vertex = true;
    }

    vec3 sum_block = block[index].rgb;
    vec3 batch_sum = vec3(0.0), batch_mean = vec3(0.0), batch_m2 = vec3(0.0);
    if (VARIANCE) {
        batch_sum = batch[3u * index].rgb;
        batch_mean = batch[3u * index + 1u].rgb;
        batch_m2 = batch[3u * index + 2u].rgb;
    }

    while (sample_index < sample_end) {
        if (at_vertex) {
            vec4 u = random4(SAMPLER, key, sample_index, depth + 1u);
            if (NEE) {
                float choice = LIGHT_COUNT > 1u ? random1(SAMPLER, key, sample_index, depth + 1u) : 0.0;
                radiance += throughput * sample_light(vertex, u.zw, choice, rays);
            }
            at_vertex = false;
            depth += 1u;
            has_ray = LAST_RAY || depth < BOUNCES;
            float weight;
            d = sample_direction(vertex, u.xy, weight, pdf);
            throughput *= weight;
            o = vertex.p;
        }
        if (has_ray) {
            has_ray = false;
            rays += 1u;
            float t = 1e30;
            uint id = closest_hit(o, d, vertex.id, t);
            if (id != NONE) {
                vertex = make_vertex(o + t * d, d, id, origin.w);
                bool camera = ANTIALIAS && depth == 0u;
                if (!NEE || LAST_RAY || camera) radiance += throughput * emission(vertex, d, t, pdf, camera);
                if (!vertex.front) vertex.albedo = vec3(0.0);
                if (camera) {
                    vec3 n = vertex.front ? vertex.n : -vertex.n;
                    sum_albedo += vertex.albedo;
                    sum_normal += n;
                    sum_screen += screen_values(n, t);
                }
                throughput *= vertex.albedo;
                at_vertex = depth < BOUNCES && vertex.albedo != vec3(0.0);
                if (camera && at_vertex) inexact += 1u;
            }
        }
        if (!at_vertex) {
            // The sample is complete.
            if (invalid(radiance)) {
                radiance = vec3(0.0);
                bad += 1u;
            }
            sum_block += radiance;
            if (VARIANCE) {
                batch_sum += radiance;
                if ((sample_index + 1u) % batch_size == 0u) {
                    vec3 mean = batch_sum / float(batch_size);
                    vec3 delta = mean - batch_mean;
                    batch_mean += delta / float((sample_index + 1u) / batch_size);
                    batch_m2 += delta * (mean - batch_mean);
                    batch_sum = vec3(0.0);
                }
            }
            sample_index += 1u;
            if (sample_index % BLOCK_SIZE == 0u) {
                sum_total.rgb += sum_block;
                sum_block = vec3(0.0);
            }
            depth = 0u;
            if (ANTIALIAS) {
                radiance = vec3(0.0);
                throughput = vec3(1.0);
                o = origin.xyz;
                d = camera_ray(vec2(pixel) + random4(SAMPLER, key, sample_index, 0u).xy);
                vertex.id = NONE;
                has_ray = true;
            } else {
                radiance = first_radiance;
                throughput = first.albedo;
                vertex = first;
                at_vertex = true;
            }
        }
    }

    total[index] = vec4(sum_total.rgb, 0.0);
    block[index] = vec4(sum_block, 0.0);
    counts[index] += uvec4(rays, sample_end - sample_begin, bad, inexact);
    if (ANTIALIAS) {
        aov_albedo[index] = vec4(sum_albedo, 0.0);
        aov_normal[index] = vec4(sum_normal, 0.0);
        aov_screen[index] = sum_screen;
    }
    if (VARIANCE) {
        batch[3u * index] = vec4(batch_sum, 0.0);
        batch[3u * index + 1u] = vec4(batch_mean, 0.0);
        batch[3u * index + 2u] = vec4(batch_m2, 0.0);
    }
}
