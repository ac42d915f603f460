// Pages whose vertices are at their heights.

// A page's place: its south-west sample counted from the eye's cell, and its stride.
struct Page {
    @location(2) origin: vec2i,
    @location(3) stride: u32,
}

// A vertex's height over another, quanta.
fn quanta_above(height: i32, base: i32, page: Page) -> f32 {
    return f32(height - base);
}

// The x and y of a vertex's normal.
fn displayed_normal(normal: vec2f, page: Page) -> vec2f {
    return normal;
}
