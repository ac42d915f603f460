// As place.wgsl, for vertices on their way: each has an offset of its own.

struct Page {
    @location(2) origin: vec2i,
    @location(3) stride: u32,
    @location(4) offset: f32, // quanta above the vertex's height
}

// The offset, too, is the same to the bit in every page that shares the vertex.
fn place(index: u32, height: i32, page: Page) -> vec3f {
    let k = i32(index % 289u);
    let steps = page.origin + vec2i(k % 17, k / 17) * i32(page.stride);
    let above = f32(height - frame.heights.x) + page.offset;
    return vec3f(vec2f(steps), above) * frame.spacing.xyz - frame.remainder.xyz;
}
