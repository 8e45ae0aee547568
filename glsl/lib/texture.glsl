// What radiance is divided by to be rid of the surface's texture, of the first two texels of a network's input; what has no albedo, an
// emitter or the sky, stays as it is.
vec3 texture_of(vec4 first, vec4 second) {
    const vec3 albedo = vec3(first.w, second.xy);
    return albedo == vec3(0.0) ? vec3(1.0) : albedo + 1.0 / float(DEMODULATION);
}
