// Pages whose vertices may be on their way: as still.wgsl, with an offset for each vertex.

struct Page {
    @location(2) origin: vec2i,
    @location(3) stride: u32,
    @location(4) rise: f32, // quanta above the vertex's height
    @location(5) half_turn: vec2f, // what half its normal lacks
}

fn quanta_above(height: i32, base: i32, page: Page) -> f32 {
    return f32(height - base) + page.rise;
}

fn displayed_normal(normal: vec2f, page: Page) -> vec2f {
    return normal + 2.0 * page.half_turn;
}
