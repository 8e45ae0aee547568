// Flat index of an invocation in a dispatch that is folded into x and y, workgroups of 64.
uint flat_index() {
    return (gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x) * 64 + gl_LocalInvocationID.x;
}
