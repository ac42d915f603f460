// The ground: tinted by height, rock where it is steep, lit by the sun and the sky.

struct Ground {
    @builtin(position) @invariant clip: vec4f,
    @location(0) from_eye: vec3f,
    @location(1) normal: vec3f,
    @location(2) height: f32, // 0 lowest, 1 highest
}

@vertex
fn vertex(
    @builtin(vertex_index) index: u32,
    @location(0) height: i32,
    @location(1) normal: vec2f,
    page: Page,
) -> Ground {
    var ground: Ground;
    ground.from_eye = place(index, height, page);
    ground.clip = frame.clip_from_eye * vec4f(ground.from_eye, 1.0);
    let shown = displayed_normal(normal, page);
    ground.normal = vec3f(shown, sqrt(max(1.0 - dot(shown, shown), 0.0)));
    ground.height = quanta_above(height, frame.heights.y, page) * frame.range.x;
    return ground;
}

// Linear colours of even steps of height.
fn ramp_earth(height: f32) -> vec3f {
    var stops = array<vec3f, 9>(
        vec3f(0.098, 0.158, 0.062), // lush lowland
        vec3f(0.150, 0.206, 0.080),
        vec3f(0.250, 0.282, 0.118), // meadow
        vec3f(0.385, 0.358, 0.178), // dry grass
        vec3f(0.428, 0.334, 0.180), // ochre
        vec3f(0.350, 0.258, 0.162), // brown
        vec3f(0.297, 0.254, 0.213), // rock
        vec3f(0.462, 0.450, 0.440), // scree and old snow
        vec3f(0.900, 0.925, 0.960), // snow
    );
    let at = clamp(height, 0.0, 1.0) * 8.0;
    let i = min(u32(at), 7u);
    return mix(stops[i], stops[i + 1u], smoothstep(0.0, 1.0, at - f32(i)));
}

fn ramp_airless(height: f32) -> vec3f {
    let shade = smoothstep(0.05, 0.95, clamp(height, 0.0, 1.0));
    return mix(vec3f(0.130, 0.127, 0.124), vec3f(0.500, 0.485, 0.462), shade);
}

fn albedo(height: f32, level: f32) -> vec3f {
    if !has_air() {
        return mix(ramp_airless(height) * 1.12, ramp_airless(height), smoothstep(0.7, 0.95, level));
    }
    let rock = mix(vec3f(0.165, 0.137, 0.108), vec3f(0.245, 0.226, 0.205), height);
    return mix(rock, ramp_earth(height), smoothstep(0.58, 0.86, level));
}

// Far relief is drawn as if it were steeper, as on maps: true slopes seen from far up look flat.
fn relief(distance: f32) -> f32 {
    return clamp(pow(distance / 12000.0, 0.36), 1.0, 5.0);
}

fn lit(colour: vec3f, normal: vec3f) -> vec3f {
    let sun = max(dot(normal, frame.sun.xyz), 0.0);
    if !has_air() {
        return colour * (1.75 * sun + 0.035);
    }
    let sky = mix(vec3f(0.15, 0.125, 0.10), vec3f(0.27, 0.33, 0.42), 0.5 + 0.5 * normal.z);
    return colour * (vec3f(1.66, 1.50, 1.24) * sun + sky);
}

@fragment
fn fragment(ground: Ground, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let distance = length(ground.from_eye);
    let tilt = frame.spacing.w;
    let n = normalize(vec3f(ground.normal.xy * tilt, max(ground.normal.z, 1e-3)));
    let k = relief(distance);
    let level = normalize(vec3f(n.xy * min(k, 1.6), n.z)).z;
    let shading = normalize(vec3f(n.xy * k, n.z));
    var colour = lit(albedo(ground.height, level), shading);
    if !front {
        colour *= 0.25; // the underside
    }
    return on_screen(through_air(colour, distance, ground.from_eye / max(distance, 1e-6)));
}
