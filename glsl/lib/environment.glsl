// What a ray meets that leaves the scene (src/scene/light.rs, EnvironmentMap; rows by src/render/environment.rs).
// Included by a shader that declares `scene` (rows of four floats) and ENVIRONMENT.
#ifndef LIMPID_ENVIRONMENT_GLSL
#define LIMPID_ENVIRONMENT_GLSL

#include "lib/sampling.glsl"

const uint ENVIRONMENT_NONE = 0u;
const uint ENVIRONMENT_CONSTANT = 1u;
const uint ENVIRONMENT_MAP = 2u;

// Rows: radiance (constant; w: the first texel), then the map's axes in the world; w: width, height, share in the choice of lights.
// Texels, row by row (w: density of the cell between it and its right and lower neighbours), then per row of cells
// (threshold, alias, cosines of its upper and lower edge), then per cell (threshold, alias): Walker's alias method.
const int ENVIRONMENT_ROW = 4;

// arctan on [-1, 1] to 2e-8 (Abramowitz and Stegun 4.4.49): the built-in one may be off by 4e-5.
float atan_unit(float x) {
    float y = x * x;
    float p = 0.0028662257;
    p = p * y - 0.0161657367;
    p = p * y + 0.0429096138;
    p = p * y - 0.0752896400;
    p = p * y + 0.1065626393;
    p = p * y - 0.1420889944;
    p = p * y + 0.1999355085;
    p = p * y - 0.3333314528;
    return x + x * y * p;
}

// The angle of (x, y) as part of a turn, in [0, 1].
float turn_of(float y, float x) {
    float a = abs(x), b = abs(y);
    float angle = atan_unit(min(a, b) / max(max(a, b), 1e-30)) / (2.0 * PI);
    angle = b > a ? 0.25 - angle : angle;
    angle = x < 0.0 ? 0.5 - angle : angle;
    return y < 0.0 ? 1.0 - angle : angle;
}

// Radiance from a direction and, of a map, the density with which light sampling takes it (share in the choice excluded).
vec4 environment(vec3 d) {
    vec4 radiance = imageLoad(scene, ENVIRONMENT_ROW);
    if (ENVIRONMENT == ENVIRONMENT_CONSTANT) return vec4(radiance.rgb, 0.0);
    vec4 x = imageLoad(scene, ENVIRONMENT_ROW + 1), y = imageLoad(scene, ENVIRONMENT_ROW + 2);
    vec3 m = vec3(dot(d, x.xyz), dot(d, y.xyz), dot(d, imageLoad(scene, ENVIRONMENT_ROW + 3).xyz));
    int width = int(x.w), height = int(y.w);
    float column = turn_of(m.x, -m.z) * x.w - 0.5;
    float row = 2.0 * turn_of(length(m.xz), m.y) * (y.w - 1.0);
    float left = floor(column), top = clamp(floor(row), 0.0, y.w - 2.0);
    vec2 f = vec2(column - left, clamp(row - top, 0.0, 1.0));
    int i = left < 0.0 ? width - 1 : int(left) % width;
    int j = i + 1 < width ? i + 1 : 0;
    int at = int(radiance.w) + int(top) * width;
    vec4 upper = imageLoad(scene, at + i);
    vec3 above = mix(upper.rgb, imageLoad(scene, at + j).rgb, f.x);
    vec3 below = mix(imageLoad(scene, at + width + i).rgb, imageLoad(scene, at + width + j).rgb, f.x);
    return vec4(mix(above, below, f.y), upper.w);
}

// A direction from the map: a row of cells, a cell of it, a point in that, by solid angle. `choice` has four more numbers than `u`.
vec3 sample_environment(vec4 choice, vec2 u) {
    int texels = int(imageLoad(scene, ENVIRONMENT_ROW).w);
    vec4 x = imageLoad(scene, ENVIRONMENT_ROW + 1), y = imageLoad(scene, ENVIRONMENT_ROW + 2);
    int width = int(x.w), height = int(y.w);
    int rows = texels + width * height;
    int cells = rows + height - 1;
    int row = min(int(choice.x * float(height - 1)), height - 2);
    vec4 entry = imageLoad(scene, rows + row);
    if (choice.y >= entry.x) {
        row = int(entry.y);
        entry = imageLoad(scene, rows + row);
    }
    int column = min(int(choice.z * x.w), width - 1);
    vec4 cell = imageLoad(scene, cells + row * width + column);
    if (choice.w >= cell.x) column = int(cell.y);
    float phi = 2.0 * PI * (float(column) + 0.5 + u.x) / x.w;
    float cosine = mix(entry.z, entry.w, u.y);
    float sine = sqrt(max(0.0, (1.0 - cosine) * (1.0 + cosine)));
    vec3 m = vec3(sine * sin(phi), cosine, -sine * cos(phi));
    return m.x * x.xyz + m.y * y.xyz + m.z * imageLoad(scene, ENVIRONMENT_ROW + 3).xyz;
}

#endif
