// The path tracer: one invocation a pixel, one flat loop in which a finished path is replaced by the next sample's at once.
// An iteration: light sampling at the current vertex, one new direction, one closest-hit query.
#version 460
#extension GL_GOOGLE_include_directive : require
#extension GL_EXT_control_flow_attributes : require
#include "lib/random.glsl"
#include "lib/sampling.glsl"

layout(local_size_x = 16, local_size_y = 4) in;

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
layout(constant_id = 15) const bool CHECKERS = false;      // a surface has two reflectances
layout(constant_id = 16) const uint DISK_FIRST = 0;        // of the rectangles, those from here on ..
layout(constant_id = 17) const uint DISK_COUNT = 0;        // .. are disks, so many
layout(constant_id = 18) const bool HALVES = false;        // even and odd samples are independent, their difference is kept
layout(constant_id = 19) const bool AOVS = true;           // first hits are kept
layout(constant_id = 21) const bool LENS = false;          // a thin lens instead of a pinhole; needs ANTIALIAS
layout(constant_id = 20) const uint ROULETTE = 0xffffffff; // from so many reflections on a path may be ended by chance

layout(constant_id = 22) const uint MATERIALS = 0;         // bits of the kinds that a surface has, beyond diffuse ones (lib/bsdf.glsl)
layout(constant_id = 23) const bool TWO_SIDED = false;     // a surface reflects on both sides
layout(constant_id = 24) const bool BITMAPS = false;       // a surface has a picture
layout(constant_id = 25) const uint DELTA_COUNT = 0;       // lights that no ray meets, after the rectangles
layout(constant_id = 27) const uint DELTA_KINDS = 0;       // one bit a kind of them (lib/lights.glsl)
layout(constant_id = 26) const uint ENVIRONMENT = 0;       // what is around the scene (lib/environment.glsl)
layout(constant_id = 28) const bool LAST_RAYS = true;      // rays go on after the last reflection's light sample

layout(constant_id = 30) const uint MESH_COUNT = 0;        // meshes share one tree of triangles
layout(constant_id = 31) const uint MESH_LIGHT_COUNT = 0;  // the first meshes
layout(constant_id = 32) const bool MESH_SMOOTH = false;   // a mesh has vertex normals
layout(constant_id = 33) const bool LOOPS_END = false;     // the driver ends a run's loops after so many rounds
layout(constant_id = 34) const uint BOX_SIDES = 0;         // the rectangles that are the sides of a box around all (lib/box.glsl)
layout(constant_id = 35) const bool SPHERES_APART = false; // no outward sphere meets another

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
// Sum of the even samples less that of the odd ones.
layout(set = 0, binding = 8, std430) buffer Difference { vec4 difference[]; };

// With triangles: set where a pixel has not all its samples yet.
layout(set = 0, binding = 15, std430) buffer Unfinished { uint unfinished[]; };

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
    uint loop_rounds; // two
};

const uint BLOCK_SIZE = 64u;
const uint ROULETTE_DIMENSIONS = 2048u; // beyond those of the choice of lights
const uint ENVIRONMENT_DIMENSIONS = 4096u; // four more numbers for a direction of the environment's map
const uint AREA_LIGHT_COUNT = SPHERE_LIGHT_COUNT + RECT_LIGHT_COUNT + MESH_LIGHT_COUNT;
const bool MAP_SAMPLED = ENVIRONMENT == 2u;
// Lights that are sampled: the rest surrounds its receivers and is left to the bounces.
const uint LIGHT_COUNT = AREA_LIGHT_COUNT + DELTA_COUNT + (MAP_SAMPLED ? 1u : 0u);
const bool NEE = ESTIMATOR == ESTIMATOR_NEE && LIGHT_COUNT > 0u;
const bool LIT = AREA_LIGHT_COUNT + INWARD_LIGHT_COUNT > 0u;
const bool ONE_LIGHT = AREA_LIGHT_COUNT + INWARD_LIGHT_COUNT == 1u && DELTA_COUNT == 0u && !MAP_SAMPLED;
const uint DELTA_FIRST = SPHERE_COUNT + RECT_COUNT + MESH_COUNT;
const uint ONE_LIGHT_ID = SPHERE_LIGHT_COUNT > 0u ? 0u : INWARD_LIGHT_COUNT > 0u ? INWARD_FIRST
    : RECT_LIGHT_COUNT > 0u ? SPHERE_COUNT : SPHERE_COUNT + RECT_COUNT;
// All rectangles across an axis?
const uint AXIS_BITS = RECT_COUNT >= 16u ? 0x55555555u : ((1u << (2u * RECT_COUNT)) - 1u) & 0x55555555u;
const bool ALIGNED = PRELOAD && ((RECT_AXES | (RECT_AXES >> 1u)) & AXIS_BITS) == AXIS_BITS;

// The streams of the pixel's samples; with HALVES odd samples of a net have a scrambling of their own, so that both halves are
// nets and independent.
uvec2 g_key, g_odd_key;
const bool TWO_NETS = HALVES && SAMPLER == SAMPLER_SOBOL;

void set_keys(uvec2 pixel) {
    g_key = pixel_key(pixel, seed);
    if (TWO_NETS) g_odd_key = pcg4d(uvec4(g_key, 0x68616c66u, 0x6f646473u)).xy;
}

uvec2 key_of(uint i) { return TWO_NETS && (i & 1u) != 0u ? g_odd_key : g_key; }
uint place_of(uint i) { return TWO_NETS ? i >> 1u : i; }

// Random numbers of a sample at a vertex of its path; 0 is the camera.
vec4 numbers(uint i, uint vertex) { return random4(SAMPLER, key_of(i), place_of(i), vertex); }
float number(uint i, uint vertex) { return random1(SAMPLER, key_of(i), place_of(i), vertex); }

#include "lib/bounce.glsl"
#include "lib/lights.glsl"
#include "lib/scene.glsl"

// NaN, infinite or negative: one unsigned comparison on the bits, which no compiler folds away.
bool invalid(vec3 x) { return max(floatBitsToUint(x.r), max(floatBitsToUint(x.g), floatBitsToUint(x.b))) >= 0x7f800000u; }

// Through a point of the film, in pixels; `o` is the eye and, with a lens, moves to the point of it that `u` chooses.
vec3 camera_ray(vec2 film_position, vec2 u, inout vec3 o) {
    vec2 film = film_position * (2.0 / vec2(width, height)) - 1.0;
    vec3 view = g_forward + film.x * g_right - film.y * g_up; // one unit deep
    if (LENS) {
        vec2 s = g_lens.x * sample_disk(u);
        vec3 shift = s.x * g_right_unit + s.y * g_up_unit;
        o += shift;
        view = g_lens.y * view - shift;
    }
    return normalize(view);
}

// Screen-space normal (x right, y up, of the side that faces the camera), depth along the ray, hit.
vec4 screen_values(vec3 n, float t) {
    return vec4(dot(n, g_right_unit), dot(n, g_up_unit), t * g_depth_scale, 1.0);
}

// A driver that has ended a loop early lets no other loop go round either. The compiler does not know the push constant.
bool loops_go_on() {
    uint rounds = 0u;
    while (rounds < loop_rounds) rounds += 1u;
    return rounds == loop_rounds;
}

void main() {
    uvec2 pixel = gl_GlobalInvocationID.xy + uvec2(0u, row_begin);
    if (pixel.x >= width || pixel.y >= row_end) return;
    uint index = (pixel.y - window_row) * width + pixel.x;
    vec4 sum_total = total[index];
    if (!ANTIALIAS && write_aov == 0u && sum_total.w != 0.0) return; // exact: nothing to add
    preload();
    set_keys(pixel);
    vec4 origin = imageLoad(scene, 0); // w: how far a ray starts off its surface
    g_offset = origin.w;

    // A driver that ends a run's loops early leaves samples of a scene with triangles for the next run.
    uint sample_index = TRIANGLES ? max(counts[index].y, sample_begin) : sample_begin;
    uint first_sample = sample_index;
    uint depth = 0u; // reflections before the current ray
    float pdf = 0.0; // of the current ray's direction
    uint chosen = ALONE, skip = NONE; // how that was chosen, and what the ray cannot hit
    float squeezed = 1.0; // radiance by the refractions so far
    uint rays = 0u, bad = 0u, inexact = 0u, sample_inexact = 0u;
    vec3 radiance = vec3(0.0), throughput = vec3(1.0), first_radiance = vec3(0.0);
    vec3 sum_albedo = vec3(0.0), sum_normal = vec3(0.0);
    vec4 sum_screen = vec4(0.0);
    vec3 sample_albedo = vec3(0.0), sample_normal = vec3(0.0);
    vec4 sample_screen = vec4(0.0);
    vec3 o = origin.xyz, d = vec3(0.0);
    bool at_vertex = false, has_ray = false; // neither: a camera ray comes next
    Vertex vertex, first;
    vertex.id = NONE;

    if (ANTIALIAS && AOVS) {
        sum_albedo = aov_albedo[index].rgb;
        sum_normal = aov_normal[index].xyz;
        sum_screen = aov_screen[index];
    }
    if (!ANTIALIAS) {
        d = camera_ray(vec2(pixel) + 0.5, vec2(0.0), o);
        float t = 1e30;
        uint id = closest_hit(o, d, NONE, t);
        if (TRIANGLES && LOOPS_END && !loops_go_on()) {
            unfinished[0] = 1u;
            return;
        }
        rays += 1u;
        bool exact = true;
        if (id != NONE) {
            first = make_vertex(o + t * d, d, id, origin.w);
            first_radiance = emission(first, o, d, t, 0.0, ALONE);
            if (!first.front) first.albedo = vec3(0.0);
            exact = BOUNCES == 0u || first.albedo == vec3(0.0);
            sum_albedo = shown_albedo(first);
            sum_normal = first.front ? first.n : -first.n;
            sum_screen = screen_values(sum_normal, t);
        } else if (ENVIRONMENT != ENVIRONMENT_NONE) {
            first_radiance = surroundings(d, 0.0, ALONE);
        }
        if (AOVS && write_aov != 0u) {
            aov_albedo[index] = vec4(sum_albedo, 0.0);
            aov_normal[index] = vec4(sum_normal, 0.0);
            aov_screen[index] = sum_screen;
        }
        if (exact) {
            // The pixel has this radiance on every sample, so all of them are dropped where it is invalid.
            bool dropped = invalid(first_radiance);
            total[index] = vec4(dropped ? vec3(0.0) : first_radiance, 1.0);
            counts[index] += uvec4(rays, 0u, dropped ? 1u : 0u, 0u);
            return;
        }
        vertex = first;
        radiance = first_radiance;
        throughput = first.albedo;
        at_vertex = true;
    }

    vec3 sum_block = block[index].rgb;
    vec3 sum_difference = HALVES ? difference[index].rgb : vec3(0.0);
    vec3 batch_sum = vec3(0.0), batch_mean = vec3(0.0), batch_m2 = vec3(0.0);
    if (VARIANCE) {
        batch_sum = batch[3u * index].rgb;
        batch_mean = batch[3u * index + 1u].rgb;
        batch_m2 = batch[3u * index + 2u].rgb;
    }

    while (sample_index < sample_end) {
        vec4 u = numbers(sample_index, at_vertex ? depth + 1u : 0u);
        if (ANTIALIAS && !at_vertex) {
            o = origin.xyz;
            d = camera_ray(vec2(pixel) + u.xy, u.zw, o);
            has_ray = true;
        } else {
            if (NEE && scatters_widely(vertex)) {
                float choice = LIGHT_COUNT > 1u || MESH_LIGHT_COUNT > 0u ? number(sample_index, depth + 1u) : 0.0;
                radiance += throughput * sample_light(vertex, u.zw, choice, sample_index, depth + 1u, rays);
            }
            at_vertex = false;
            depth += 1u;
            has_ray = LAST_RAYS || depth < BOUNCES;
            Bounce bounce = sample_bounce(vertex, u.xy);
            d = bounce.d;
            o = bounce.o;
            pdf = bounce.pdf;
            throughput *= bounce.weight;
            if (BSDFS || HOLLOW) {
                chosen = bounce.chosen;
                skip = bounce.skip;
                squeezed *= bounce.squeeze;
                has_ray = has_ray && throughput != vec3(0.0);
            }
        }
        if (has_ray) {
            has_ray = false;
            rays += 1u;
            float t = 1e30;
            bool camera = ANTIALIAS && depth == 0u;
            if (!BSDFS && !HOLLOW) {
                chosen = camera ? ALONE : WIDELY;
                skip = vertex.id;
            }
            uint id = closest_hit(o, d, skip, t);
            if (id == NONE) {
                if (ENVIRONMENT != ENVIRONMENT_NONE) radiance += throughput * surroundings(d, pdf, chosen);
            } else {
                vertex = make_vertex(o + t * d, d, id, origin.w);
                if (LAST_RAYS || camera) radiance += throughput * emission(vertex, o, d, t, pdf, chosen);
                if (!vertex.front) vertex.albedo = vec3(0.0);
                if (AOVS && camera) {
                    vec3 n = vertex.front ? vertex.n : -vertex.n;
                    sample_albedo = shown_albedo(vertex);
                    sample_normal = n;
                    sample_screen = screen_values(n, t);
                }
                throughput *= vertex.albedo;
                at_vertex = depth < BOUNCES && vertex.albedo != vec3(0.0);
                if (camera && at_vertex) sample_inexact = 1u;
                if (ROULETTE < BOUNCES && at_vertex && depth >= ROULETTE) {
                    float survival = min(0.95, max(throughput.r, max(throughput.g, throughput.b)) / squeezed);
                    at_vertex = number(sample_index, ROULETTE_DIMENSIONS + depth) < survival;
                    throughput /= survival;
                }
            }
        }
        if (!at_vertex) {
            // The sample is complete.
            if (TRIANGLES && LOOPS_END && !loops_go_on()) break; // or cut short: the next run begins it again
            if (ANTIALIAS) {
                sum_albedo += sample_albedo;
                sum_normal += sample_normal;
                sum_screen += sample_screen;
                inexact += sample_inexact;
                sample_albedo = sample_normal = vec3(0.0);
                sample_screen = vec4(0.0);
                sample_inexact = 0u;
            }
            if (invalid(radiance)) {
                radiance = vec3(0.0);
                bad += 1u;
            }
            sum_block += radiance;
            if (HALVES) sum_difference += (sample_index & 1u) == 0u ? radiance : -radiance;
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
                // What the sum loses in rounding goes into the next block (Kahan), so that sums of any length are exact to f32.
                precise vec3 sum = sum_total.rgb + sum_block;
                precise vec3 lost = sum_block - (sum - sum_total.rgb);
                sum_total.rgb = sum;
                sum_block = lost;
            }
            depth = 0u;
            squeezed = 1.0;
            if (ANTIALIAS) {
                radiance = vec3(0.0);
                throughput = vec3(1.0);
                vertex.id = NONE;
                chosen = ALONE;
                skip = NONE;
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
    counts[index] += uvec4(rays, sample_index - first_sample, bad, inexact);
    if (TRIANGLES && sample_index < sample_end) unfinished[0] = 1u; // whoever writes, writes the same
    if (ANTIALIAS && AOVS) {
        aov_albedo[index] = vec4(sum_albedo, 0.0);
        aov_normal[index] = vec4(sum_normal, 0.0);
        aov_screen[index] = sum_screen;
    }
    if (HALVES) difference[index] = vec4(sum_difference, 0.0);
    if (VARIANCE) {
        batch[3u * index] = vec4(batch_sum, 0.0);
        batch[3u * index + 1u] = vec4(batch_mean, 0.0);
        batch[3u * index + 2u] = vec4(batch_m2, 0.0);
    }
}
