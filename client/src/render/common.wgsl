// What all passes share: the frame, the air, and the step to the screen's values.

struct Frame {
    clip_from_eye: mat4x4f,
    right: vec4f,         // xyz: to the picture's right edge, at depth 1
    up: vec4f,            // xyz: to the picture's upper edge, at depth 1
    forward: vec4f,       // xyz
    sun: vec4f,           // xyz: unit vector towards it
    spacing: vec4f,       // xyz: metres a column, a row, a quantum; w: exaggeration
    remainder: vec4f,     // xyz: the eye from the cell and height it is counted from, metres
    heights: vec4i,       // the eye's, the lowest; in quanta
    range: vec4f,         // 1 / quanta of relief; the eye over the lowest ground, metres; pixels a radian
    air: vec4f,           // share scattered a metre on the ground; height over which it falls to 1/e, metres
    flags: vec4u,         // body has air; the target needs gamma applied
}

@group(0) @binding(0) var<uniform> frame: Frame;

const HORIZON = vec3f(0.62, 0.74, 0.88);
const ZENITH = vec3f(0.10, 0.24, 0.56);
const SPACE = vec3f(0.004, 0.007, 0.016);
// Short waves are scattered more.
const SCATTER = vec3f(0.62, 0.88, 1.30);

fn has_air() -> bool {
    return frame.flags.x != 0u;
}

// Share of light that gets through `metres` of air of the density on the ground.
fn passing(metres: f32) -> vec3f {
    return exp(-SCATTER * (frame.air.x * metres));
}

// Metres of ground-dense air between the eye and a point, along a unit direction.
fn air_to(distance: f32, direction: vec3f) -> f32 {
    let fall = frame.air.y;
    let eye = max(frame.range.y, 0.0) / fall;
    let rise = direction.z * distance / fall;
    if abs(rise) < 1e-3 {
        return distance * exp(-eye);
    }
    return (exp(-eye) - exp(-max(eye + rise, 0.0))) * fall / direction.z;
}

// What the air itself sends towards the eye where it is thick.
fn haze(direction: vec3f) -> vec3f {
    let towards_sun = 0.5 + 0.5 * dot(direction.xy, normalize(frame.sun.xy + vec2f(1e-6)));
    return HORIZON * mix(vec3f(0.93, 0.97, 1.0), vec3f(1.10, 1.04, 0.96), towards_sun);
}

fn through_air(colour: vec3f, distance: f32, direction: vec3f) -> vec3f {
    if !has_air() {
        return colour;
    }
    return mix(haze(direction), colour, passing(air_to(distance, direction)));
}

// Bright values are bent below 1, so that snow in the sun keeps its shape.
fn shoulder(colour: vec3f) -> vec3f {
    let over = max(colour - 0.7, vec3f(0.0));
    return min(colour, vec3f(0.7)) + 0.3 * (1.0 - exp(-over / 0.3));
}

fn on_screen(colour: vec3f) -> vec4f {
    let linear = clamp(shoulder(colour), vec3f(0.0), vec3f(1.0));
    if frame.flags.y == 0u {
        return vec4f(linear, 1.0);
    }
    let low = linear * 12.92;
    let high = 1.055 * pow(linear, vec3f(1.0 / 2.4)) - 0.055;
    return vec4f(select(high, low, linear <= vec3f(0.0031308)), 1.0);
}

// From the eye, metres. Only integers that are the same in every page that shares the vertex go
// in, and an offset that is the same to the bit, so the result is, too: no cracks. A page's
// vertices start at a multiple of 289, so that the index says the place whether or not it counts
// the first vertex in.
fn place(index: u32, height: i32, page: Page) -> vec3f {
    let k = i32(index % 289u);
    let steps = page.origin + vec2i(k % 17, k / 17) * i32(page.stride);
    let above = quanta_above(height, frame.heights.x, page);
    return vec3f(vec2f(steps), above) * frame.spacing.xyz - frame.remainder.xyz;
}
