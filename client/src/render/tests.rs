//! Pictures on a real adapter; software Vulkan counts. Without any adapter these tests fail, and
//! say what to install.

use super::{DrawParams, Gpu, Headless, Output, Scene, render_to_image};
use crate::app::TerrainClient;
use crate::app::fake::{FakeTerrain, full_triangles};
use crate::camera::{DEFAULT_FOV_Y, look_at, overview};
use crate::mesh::{Offset, PageMesh, Vertex};
use escarp_proto::geometry::PageId;
use escarp_proto::georef::{Georef, Plane, WorldBox};
use escarp_proto::view::View;
use glam::DVec3;
use image::RgbaImage;
use std::sync::OnceLock;

fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| Gpu::headless().unwrap_or_else(|error| panic!("{error}")))
}

fn overview_of(terrain: &FakeTerrain, size: [u32; 2]) -> View {
    let manifest = terrain.manifest().unwrap();
    let aspect = f64::from(size[0]) / f64::from(size[1]);
    let (eye, look) = overview(&manifest, DEFAULT_FOV_Y, aspect);
    look_at(eye, look, DEFAULT_FOV_Y, size, 2.0)
}

fn scene_of(terrain: &FakeTerrain, samples: u32, lists: bool) -> Scene {
    let manifest = terrain.manifest().unwrap();
    let output = Output::image(samples);
    let mut scene = Scene::with_line_lists(
        gpu(),
        &manifest.georef,
        manifest.height_range,
        output,
        lists,
    );
    scene.sync(terrain.pages().iter());
    scene
}

/// Average colour of a part of a picture, given in shares of its sides.
fn average(image: &RgbaImage, x: [f64; 2], y: [f64; 2]) -> [f64; 3] {
    let at = |side: u32, share: f64| (f64::from(side) * share) as u32;
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for j in at(image.height(), y[0])..at(image.height(), y[1]) {
        for i in at(image.width(), x[0])..at(image.width(), x[1]) {
            let pixel = image.get_pixel(i, j).0;
            (0..3).for_each(|c| sum[c] += f64::from(pixel[c]));
            count += 1.0;
        }
    }
    sum.map(|s| s / count)
}

#[test]
fn a_picture_shows_sky_above_and_ground_below_and_the_same_picture_twice() {
    let terrain = FakeTerrain::new(8, Plane::Local, 64);
    let size = [250, 141]; // rows that are no multiple of 256 bytes
    let [x, y, _] = terrain.manifest().unwrap().extent_m();
    let eye = [(x[0] + x[1]) / 2.0, y[0] + 300.0, 2500.0];
    let look = [eye[0], y[1], 1500.0];
    let params = DrawParams::new(look_at(eye, look, DEFAULT_FOV_Y, size, 2.0));
    let mut scene = scene_of(&terrain, 4, false);
    let image = render_to_image(gpu(), &mut scene, &params).unwrap();
    let sky = average(&image, [0.0, 1.0], [0.0, 0.1]);
    let ground = average(&image, [0.3, 0.7], [0.8, 1.0]);
    assert!(
        sky[2] > sky[0] + 10.0 && sky[2] > 100.0,
        "the sky is {sky:?}"
    );
    assert!(
        ground[1] > ground[2] + 10.0 && ground[1] > 40.0,
        "the ground is {ground:?}"
    );
    assert!(image.pixels().all(|pixel| pixel.0[3] == 255));
    assert_eq!(image, render_to_image(gpu(), &mut scene, &params).unwrap());
}

#[test]
fn a_body_without_air_has_a_black_sky_and_grey_ground() {
    let moon = Plane::Geographic {
        crs: "IAU:30100".into(),
        radius_m: 1_737_400.0,
        middle_longitude_deg: 0.0,
        middle_latitude_deg: 0.0,
    };
    let terrain = FakeTerrain::new(4, moon, 16);
    let params = DrawParams::new(overview_of(&terrain, [128, 96]));
    let image = render_to_image(gpu(), &mut scene_of(&terrain, 1, false), &params).unwrap();
    assert_eq!(image.get_pixel(1, 1).0, [0, 0, 0, 255]);
    let [r, g, b] = average(&image, [0.4, 0.6], [0.4, 0.6]);
    assert!(
        r > 30.0 && (r - b).abs() < 0.2 * r && (r - g).abs() < 0.2 * r,
        "{r} {g} {b}"
    );
}

#[test]
fn the_wireframe_is_the_same_from_polygons_and_from_lists() {
    let terrain = FakeTerrain::new(2, Plane::Local, 4);
    let mut params = DrawParams::new(overview_of(&terrain, [320, 240]));
    let mut scene = scene_of(&terrain, 1, true);
    let plain = render_to_image(gpu(), &mut scene, &params).unwrap();
    params.wireframe = true;
    let lists = render_to_image(gpu(), &mut scene, &params).unwrap();
    let part = |image: &RgbaImage| average(image, [0.4, 0.6], [0.4, 0.6])[1];
    assert!(
        part(&lists) < part(&plain) - 5.0,
        "{} {}",
        part(&lists),
        part(&plain)
    );
    if gpu().draws_line_polygons() {
        let polygons = render_to_image(gpu(), &mut scene_of(&terrain, 1, false), &params).unwrap();
        // An edge that two triangles draw is darker than one that is drawn once.
        assert!(part(&polygons) < part(&plain) - 5.0);
    }
}

#[test]
fn only_what_changed_is_uploaded_and_what_is_gone_is_forgotten() {
    let terrain = FakeTerrain::new(4, Plane::Local, 16);
    let mut pages = terrain.pages().to_vec();
    let mut scene = scene_of(&terrain, 1, false);
    let of = |page: &PageMesh| (page.vertices.len() * 8, page.indices.len() * 2);
    assert_eq!(scene.sync(pages.iter()).bytes, 0);
    pages[3].indices.truncate(300);
    pages[3].index_stamp = u64::MAX;
    assert_eq!(scene.sync(pages.iter()).bytes, of(&pages[3]).1 as u64);
    pages[5].vertex_stamp = u64::MAX;
    assert_eq!(scene.sync(pages.iter()).bytes, of(&pages[5]).0 as u64);
    pages[6].indices.clear();
    pages[6].index_stamp = u64::MAX - 1;
    let stats = scene.sync(pages.iter());
    assert_eq!((stats.bytes, stats.pages_changed), (0, 1));
    let gone = pages.pop().unwrap();
    assert_eq!(scene.sync(pages.iter()).pages_removed, 1);
    let mut target = Headless::new(gpu(), [64, 64], 1).unwrap();
    let params = DrawParams::new(overview_of(&terrain, [64, 64]));
    let (_, drawn) = target.render(&mut scene, &params).unwrap();
    assert_eq!((drawn.pages_drawn, drawn.pages_culled), (14, 0));
    assert_eq!(drawn.triangles_drawn, 13 * 512 + 100);
    pages.push(gone);
    let (vertices, indices) = of(&pages[15]);
    assert_eq!(scene.sync(pages.iter()).bytes, (vertices + indices) as u64);
}

#[test]
fn a_picture_without_area_or_too_large_is_refused() {
    let error = |size| Headless::new(gpu(), size, 1).err().unwrap().to_string();
    assert!(error([0, 10]).starts_with("a picture of 0 x 10 px, allowed are 1..="));
    assert!(error([10, 1 << 20]).contains("1048576"));
}

/// Three pages around a seam: to the west two of stride 1, to the east one of stride 2.
///
/// ```text
///  +-------+---------------+
///  | fine  |               |   The fine pages use every second vertex of the seam, as the
///  +-------+    coarse     |   coarse one does; with `torn` they use all, which tears it.
///  | fine  |               |
///  +-------+---------------+
///          ^ the seam: column 64
/// ```
fn seam(georef: &Georef, torn: bool) -> Vec<PageMesh> {
    let level = 8;
    [(3, 0, 1), (3, 1, 1), (4, 0, 2)]
        .map(|(x, y, stride)| {
            let origin = [x * 16, y * 16];
            let vertices = (0..289).map(|k: u32| Vertex {
                height: bumps(origin[0] + k % 17 * stride, origin[1] + k / 17 * stride),
                normal: [0, 0],
            });
            let fans = fans(stride == 1 && !torn);
            let end = [origin[0] + 16 * stride, origin[1] + 16 * stride];
            let id = PageId::new(level, x, y).unwrap();
            PageMesh {
                id,
                origin,
                stride,
                bounds: WorldBox {
                    min: georef.world(origin[0], origin[1], -BUMP),
                    max: georef.world(end[0], end[1], BUMP),
                },
                vertices: vertices.collect(),
                vertex_stamp: id.key() + 1,
                offsets: None,
                offset_stamp: 0,
                indices: if stride == 1 { fans } else { full_triangles() },
                index_stamp: id.key() + 1,
            }
        })
        .into()
}

const BUMP: i32 = 1500;

fn bumps(x: u32, y: u32) -> i32 {
    (x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77)).rotate_left(9) as i32 % BUMP
}

/// Fans of two by two cells; without the edge vertices in the page's eastern border, if so wished.
fn fans(no_east: bool) -> Vec<u16> {
    let mut indices = Vec::new();
    for centre in (0..64).map(|k| (k / 8 * 2 + 1) * 17 + k % 8 * 2 + 1) {
        let ring: [i32; 8] = [1, 18, 17, 16, -1, -18, -17, -16].map(|step| centre + step);
        let kept: Vec<i32> = ring
            .into_iter()
            .filter(|&k| !(no_east && k == centre + 1 && k % 17 == 16))
            .collect();
        for i in 0..kept.len() {
            let next = kept[(i + 1) % kept.len()];
            indices.extend([centre, kept[i], next].map(|k| k as u16));
        }
    }
    indices
}

/// Pixels of the background in pictures of the seam from many eyes, none of which sees past it.
fn holes(origin_m: [f64; 2], spacing_m: f64, torn: bool) -> usize {
    let georef = Georef {
        origin_m,
        sample_spacing_m: [spacing_m, spacing_m * 0.77],
        quantum_m: spacing_m * 1e-3,
        plane: Plane::Local,
    };
    let mut scene = Scene::new(gpu(), &georef, Some([-BUMP, BUMP]), Output::image(1));
    scene.sync(seam(&georef, torn).iter());
    let mut target = Headless::new(gpu(), [96, 96], 1).unwrap();
    let magenta = wgpu::Color {
        r: 1.0,
        g: 0.0,
        b: 1.0,
        a: 1.0,
    };
    let mut random = Random(origin_m[0].to_bits() | 1);
    let mut pictures = (0..120).map(|_| {
        let params = DrawParams::new(eye_on_the_seam(&georef, &mut random));
        let (image, _) = target
            .render_over(&mut scene, &params, Some(magenta))
            .unwrap();
        image
            .pixels()
            .filter(|pixel| pixel.0 == [255, 0, 255, 255])
            .count()
    });
    pictures.by_ref().sum()
}

/// An eye that looks down at a place of the seam from near or far, and sees only a few cells.
fn eye_on_the_seam(georef: &Georef, random: &mut Random) -> View {
    let row = 6.0 + 20.0 * random.share();
    let spacing = georef.sample_spacing_m[0];
    let look = DVec3::new(
        georef.world_x(64),
        georef.origin_m[1] + row * georef.sample_spacing_m[1],
        0.0,
    );
    let distance = spacing * 10f64.powf(0.6 + 2.9 * random.share());
    let (turn, rise) = (
        random.share() * std::f64::consts::TAU,
        0.8 + 0.7 * random.share(),
    );
    let (level, up) = (f64::cos(rise), f64::sin(rise));
    let eye = look + DVec3::new(turn.cos() * level, turn.sin() * level, up) * distance;
    let fov = (2.0 * (1.7 * spacing / distance).atan()).max(0.001);
    look_at(eye.into(), look.into(), fov, [96, 96], 2.0)
}

struct Random(u64);

impl Random {
    /// 0 to 1; xorshift.
    fn share(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[test]
fn no_background_shines_through_a_seam_of_pages_from_any_eye() {
    for origin in [[0.0, 0.0], [1e7, -1e7], [-412_345.678, 5e6]] {
        for spacing in [0.01, 30.0, 3210.9] {
            assert_eq!(
                holes(origin, spacing, false),
                0,
                "origin {origin:?}, {spacing} m"
            );
        }
    }
}

#[test]
fn the_seam_test_finds_a_seam_that_is_torn() {
    assert!(holes([1e7, -1e7], 30.0, true) > 100);
}

#[test]
fn vertices_on_their_way_are_drawn_where_they_are_and_leave_no_trace() {
    let terrain = FakeTerrain::new(4, Plane::Local, 16);
    let params = DrawParams::new(overview_of(&terrain, [160, 120]));
    let mut scene = scene_of(&terrain, 1, false);
    let mut draw = |pages: &[PageMesh]| {
        scene.sync(pages.iter());
        render_to_image(gpu(), &mut scene, &params).unwrap()
    };
    let still = draw(terrain.pages());
    // Heights so much too low, and offsets that make up for it: the same picture.
    let offset = |k: usize| (k % 7) as i32 * 400;
    let lowered = |page: &PageMesh, with: bool, stamp: u64| {
        let mut page = page.clone();
        let vertices = page.vertices.iter_mut().enumerate();
        vertices.for_each(|(k, vertex)| vertex.height -= offset(k));
        let rise = |k| Offset {
            rise: offset(k) as f32,
            ..Offset::default()
        };
        let offsets = (0..289).map(rise).collect();
        page.offsets = with.then_some(offsets);
        page.vertex_stamp += 1 << 40;
        page.offset_stamp = stamp;
        page
    };
    let pages = |with, stamp| -> Vec<PageMesh> {
        let pages = terrain.pages().iter();
        pages.map(|page| lowered(page, with, stamp)).collect()
    };
    let low = draw(&pages(false, 0));
    assert!(
        share_off(&low, &still) > 0.02,
        "{}",
        share_off(&low, &still)
    );
    assert!(share_off(&draw(&pages(true, 1)), &still) < 0.001);
    // Offsets go as they came, and a page that takes the place of another has none of its own.
    assert_eq!(draw(&pages(false, 2)), low);
    draw(&pages(true, 3));
    draw(&[]);
    assert_eq!(draw(&pages(false, 0)), low);
}

/// Share of pixels that differ by more than a few steps.
fn share_off(a: &RgbaImage, b: &RgbaImage) -> f64 {
    let pairs = a.pixels().zip(b.pixels());
    let off = pairs.filter(|(a, b)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 4));
    off.count() as f64 / (a.width() * a.height()) as f64
}
