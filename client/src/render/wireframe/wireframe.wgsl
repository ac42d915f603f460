// The triangles' edges over the shaded ground.

struct Line {
    @builtin(position) @invariant clip: vec4f,
    @location(0) from_eye: vec3f,
    @location(1) @interpolate(flat) cell_m: f32, // the page's own, to the east
}

// Lines are drawn this share of their distance nearer, so that the ground does not hide them.
const NEARER = 1.0005;

@vertex
fn vertex(@builtin(vertex_index) index: u32, @location(0) height: i32, page: Page) -> Line {
    var line: Line;
    line.from_eye = place(index, height, page);
    line.clip = frame.clip_from_eye * vec4f(line.from_eye, 1.0);
    line.clip.z *= NEARER;
    line.cell_m = f32(page.stride) * frame.spacing.x;
    return line;
}

@fragment
fn fragment(line: Line) -> @location(0) vec4f {
    let distance = length(line.from_eye);
    let direction = line.from_eye / max(distance, 1e-6);
    let ink = select(vec3f(0.75, 0.85, 1.0), vec3f(0.012, 0.02, 0.05), has_air());
    let colour = on_screen(through_air(ink, distance, direction));
    // Where lines are closer than a few pixels they fade, lest they hide the ground.
    let cell_px = line.cell_m * frame.range.z / max(distance, 1e-6);
    let share = clamp(cell_px / 5.0, 0.2, 1.0);
    return vec4f(colour.rgb, share * select(0.30, 0.42, has_air()));
}
