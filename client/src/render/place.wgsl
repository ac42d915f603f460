// A page's place: its south-west sample counted from the eye's cell, and its stride.
struct Page {
    @location(2) origin: vec2i,
    @location(3) stride: u32,
}

// From the eye, metres. Only integers that are the same in every page that shares the vertex go
// in, so the result is the same to the bit: no cracks. A page's vertices start at a multiple of
// 289, so that the index says the place whether or not it counts the first vertex in.
fn place(index: u32, height: i32, page: Page) -> vec3f {
    let k = i32(index % 289u);
    let steps = page.origin + vec2i(k % 17, k / 17) * i32(page.stride);
    let above = height - frame.heights.x;
    return vec3f(vec2f(steps), f32(above)) * frame.spacing.xyz - frame.remainder.xyz;
}
