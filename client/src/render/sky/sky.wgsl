// What is seen where there is no data: the sky, and below the horizon a plain of no colour.

struct Ray {
    @builtin(position) clip: vec4f,
    @location(0) direction: vec3f,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> Ray {
    let corner = vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0;
    var ray: Ray;
    ray.clip = vec4f(corner, 0.0, 1.0); // depth 0 is infinitely far
    ray.direction = frame.forward.xyz + frame.right.xyz * corner.x + frame.up.xyz * corner.y;
    return ray;
}

const PLAIN = vec3f(0.150, 0.176, 0.212);
// The sky is much deeper than the haze before the ground: it is lit through all its depth.
const DEPTH = 7.0;

fn sky(direction: vec3f) -> vec3f {
    let density = exp(-max(frame.range.y, 0.0) / frame.air.y);
    let metres = frame.air.y * density / max(direction.z, 1e-4);
    let dark = mix(SPACE, ZENITH, passing_share(metres * DEPTH));
    let near_horizon = 1.0 - passing(metres);
    let limb = exp(-direction.z * 30.0);
    return mix(dark, haze(direction), max(near_horizon, vec3f(limb) * 0.9));
}

fn passing_share(metres: f32) -> vec3f {
    return 1.0 - passing(metres);
}

fn plain(direction: vec3f) -> vec3f {
    let distance = max(frame.range.y, 1.0) / max(-direction.z, 1e-6);
    return through_air(PLAIN, distance, direction);
}

@fragment
fn fragment(ray: Ray) -> @location(0) vec4f {
    let direction = normalize(ray.direction);
    if !has_air() {
        return on_screen(vec3f(0.0));
    }
    if direction.z > 0.0 {
        return on_screen(sky(direction));
    }
    return on_screen(plain(direction));
}
