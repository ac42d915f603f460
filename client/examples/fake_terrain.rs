//! Looks at a terrain from a formula, without a server: in a window, or, given a folder, in a few
//! pictures there. `cargo run --release -p escarp-client --example fake_terrain [FOLDER [moon]]`

use escarp_client::app::TerrainClient;
use escarp_client::app::fake::FakeTerrain;
use escarp_client::app::viewer::{ViewerOptions, run};
use escarp_client::camera::{DEFAULT_FOV_Y, look_at, overview};
use escarp_client::flight::default_path;
use escarp_client::render::{DrawParams, Gpu, Headless, Output, Scene};
use escarp_proto::georef::Plane;
use std::path::Path;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let folder = args.next();
    let plane = match args.next() {
        Some(_) => Plane::Geographic {
            crs: "IAU:30100".into(),
            radius_m: 1_737_400.0,
            middle_longitude_deg: 0.0,
            middle_latitude_deg: 0.0,
        },
        None => Plane::Local,
    };
    let terrain = FakeTerrain::new(32, plane, 16);
    match folder {
        Some(folder) => pictures(&terrain, Path::new(&folder)),
        None => Ok(run(terrain, ViewerOptions::default())?),
    }
}

fn pictures(terrain: &FakeTerrain, folder: &Path) -> anyhow::Result<()> {
    let manifest = terrain
        .manifest()
        .ok_or_else(|| anyhow::anyhow!("no manifest"))?;
    let size = [1280, 720];
    let began = Instant::now();
    let gpu = Gpu::headless()?;
    println!("{} open after {:?}", gpu.describe(), began.elapsed());
    let mut target = Headless::new(&gpu, size, 4)?;
    let mut scene = Scene::new(
        &gpu,
        &manifest.georef,
        manifest.height_range,
        Output::image(4),
    );
    println!(
        "{:?}, {:?}",
        scene.sync(terrain.pages().iter()),
        began.elapsed()
    );
    let mut shoot = |name: &str, params: DrawParams| -> anyhow::Result<()> {
        let began = Instant::now();
        let (image, stats) = target.render(&mut scene, &params)?;
        println!("{name}: {stats:?} in {:?}", began.elapsed());
        Ok(image.save(folder.join(name))?)
    };
    let (eye, look) = overview(&manifest, DEFAULT_FOV_Y, 16.0 / 9.0);
    let view = look_at(eye, look, DEFAULT_FOV_Y, size, 2.0);
    shoot("overview.png", DrawParams::new(view))?;
    let path = default_path(&manifest);
    for second in [3, 5, 7, 9, 12, 16] {
        let view = path.view(f64::from(second));
        shoot(&format!("path-{second:02}.png"), DrawParams::new(view))?;
    }
    let wireframe = true;
    shoot(
        "wireframe.png",
        DrawParams {
            wireframe,
            ..DrawParams::new(path.view(18.0))
        },
    )?;
    let view = look_at(
        [419_000.0, 5_100_000.0, 2400.0],
        [419_300.0, 5_101_000.0, 2250.0],
        1.0,
        size,
        2.0,
    );
    shoot("low.png", DrawParams::new(view))
}
