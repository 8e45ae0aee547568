// What radiance is divided by to be rid of the surface's texture; what has no albedo, an emitter or the sky, stays as it is.
vec3 texture_of(vec3 albedo) {
    return albedo == vec3(0.0) ? vec3(1.0) : albedo + 1.0 / float(DEMODULATION);
}
