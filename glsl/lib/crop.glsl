// Where pixel (x, y) of a crop of `size` comes from: transposed, mirrored, then moved to the crop's origin.
// Orientation: bit 0 mirrors x, bit 1 mirrors y, bit 2 swaps x and y (first).
ivec2 crop_source(ivec2 p, ivec2 size, ivec2 origin, uint orientation) {
    if ((orientation & 4u) != 0u) p = p.yx;
    if ((orientation & 1u) != 0u) p.x = size.x - 1 - p.x;
    if ((orientation & 2u) != 0u) p.y = size.y - 1 - p.y;
    return origin + p;
}

// The screen-space normal of that pixel: in the picture x points right and y up.
vec2 crop_normal(vec2 n, uint orientation) {
    if ((orientation & 1u) != 0u) n.x = -n.x;
    if ((orientation & 2u) != 0u) n.y = -n.y;
    if ((orientation & 4u) != 0u) n = -n.yx;
    return n;
}

// The world-space normal of that pixel: the component in the picture's plane turns as the screen-space normal does, as if the
// scene had been mirrored before the same camera. `right` and `up` are the camera's, unit length.
vec3 crop_normal_world(vec3 n, vec3 right, vec3 up, uint orientation) {
    const vec2 screen = vec2(dot(n, right), dot(n, up));
    const vec2 change = crop_normal(screen, orientation) - screen;
    return n + change.x * right + change.y * up;
}
