// Pages whose vertices may be on their way: as still.wgsl, with an offset for each vertex.

struct Page {
    @location(2) origin: vec2i,
    @location(3) stride: u32,
    @location(4) offset: f32, // quanta above the vertex's height
}

fn quanta_above(height: i32, base: i32, page: Page) -> f32 {
    return f32(height - base) + page.offset;
}
