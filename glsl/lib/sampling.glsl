// Directions from uniform numbers. No inverse trigonometry: acos is off by 1e-4 on some devices.
#ifndef LIMPID_SAMPLING_GLSL
#define LIMPID_SAMPLING_GLSL

const float PI = 3.14159265358979;

// Uniform on the unit sphere.
vec3 sample_sphere(vec2 u) {
    float z = 1.0 - 2.0 * u.x;
    float r = sqrt(max(0.0, 1.0 - z * z));
    float phi = 2.0 * PI * u.y;
    return vec3(r * cos(phi), r * sin(phi), z);
}

// Cosine-distributed about `n`: the sum of the normal and a point on the unit sphere, without a tangent frame.
vec3 sample_cosine(vec3 n, vec2 u) {
    vec3 d = n + sample_sphere(u);
    float length2 = dot(d, d);
    return length2 > 1e-8 ? d * inversesqrt(length2) : n;
}

// Uniform on the hemisphere about `n`.
vec3 sample_hemisphere(vec3 n, vec2 u) {
    vec3 d = sample_sphere(u);
    return dot(d, n) < 0.0 ? -d : d;
}

// Uniform in the unit disk.
vec2 sample_disk(vec2 u) {
    float r = sqrt(u.x);
    float phi = 2.0 * PI * u.y;
    return vec2(r * cos(phi), r * sin(phi));
}

// Uniform in a triangle: weights of its second and third vertex.
vec2 sample_triangle(vec2 u) {
    float root = sqrt(u.x);
    return vec2(1.0 - root, root * u.y);
}

// 1 - cos of the half angle under which a sphere is seen, s2 = (radius / distance)^2; free of cancellation for far lights.
float cone_one_minus_cos(float s2) { return s2 / (1.0 + sqrt(max(0.0, 1.0 - s2))); }

// Two unit vectors that make a right-handed basis with the unit vector `n` (Duff et al., "Building an Orthonormal Basis, Revisited",
// JCGT 6(1), 2017).
void make_basis(vec3 n, out vec3 tangent, out vec3 bitangent) {
    float s = n.z < 0.0 ? -1.0 : 1.0;
    float a = -1.0 / (s + n.z);
    float b = n.x * n.y * a;
    tangent = vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x);
    bitangent = vec3(b, s + n.y * n.y * a, -n.y);
}

// Uniform in the cone about the unit vector `axis`; `one_minus_cos` is set to that of the direction returned.
vec3 sample_cone(vec3 axis, float cone, vec2 u, out float one_minus_cos) {
    one_minus_cos = u.x * cone;
    float radius = sqrt(one_minus_cos * (2.0 - one_minus_cos));
    float phi = 2.0 * PI * u.y;
    vec3 tangent, bitangent;
    make_basis(axis, tangent, bitangent);
    return axis * (1.0 - one_minus_cos) + tangent * (radius * cos(phi)) + bitangent * (radius * sin(phi));
}

#endif
