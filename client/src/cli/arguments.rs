//! Arguments that the commands share, and how they are read.

use crate::cache::{CacheOptions, DEFAULT_CACHE_BYTES, default_folder};
use crate::camera::overview;
use crate::governor::{TIME_BUDGETS_MS, TRIANGLE_BUDGETS};
use crate::mesh::{DEFAULT_MORPH, MORPH_SHARES, MeshOptions, MesherKind, Metric};
use crate::net::{Credentials, TOKEN_VARIABLE, Url};
use crate::remote::{ClientOptions, RemoteTerrain};
use crate::stages::Budget;
use anyhow::{Result, bail};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use escarp_proto::manifest::Manifest;
use escarp_proto::view::{FARTHEST_EYE_M, SCREEN_ERRORS_PX};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

/// Vertical field of view, radians.
pub(super) const FOV_Y: f64 = std::f64::consts::FRAC_PI_3;

/// A position in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Position(pub(super) [f64; 3]);

impl FromStr for Position {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("{text:?} is no position; write X,Y,Z in metres, such as 500,-1200,800");
        let numbers: Vec<f64> = text
            .split(',')
            .map(|part| part.trim().parse().map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        let position: [f64; 3] = numbers.try_into().map_err(|_| wrong())?;
        let is_allowed = |v: &&f64| v.abs() <= FARTHEST_EYE_M;
        match position.iter().find(|v| !is_allowed(v)) {
            None => Ok(Position(position)),
            Some(found) => Err(format!(
                "a coordinate of {found:e} m, allowed are -{FARTHEST_EYE_M:e} to {FARTHEST_EYE_M:e} m"
            )),
        }
    }
}

/// Width and height of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Size(pub(super) [u32; 2]);

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("{text:?} is no size; write WxH in pixels, 1x1 to 8192x8192, such as 1280x720")
        };
        let (width, height) = text.split_once('x').ok_or_else(wrong)?;
        let side = |text: &str| text.parse().ok().filter(|side| (1..=8192).contains(side));
        Ok(Size([
            side(width).ok_or_else(wrong)?,
            side(height).ok_or_else(wrong)?,
        ]))
    }
}

pub(super) fn error_px(text: &str) -> Result<f32, String> {
    let [least, most] = SCREEN_ERRORS_PX;
    let value: f32 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if (least..=most).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} px, allowed are {least} to {most}"))
    }
}

fn ms_within(text: &str, [least, most]: [f64; 2]) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    match (least..=most).contains(&value) {
        true => Ok(value),
        false => Err(format!("{value} ms, allowed are {least} to {most}")),
    }
}

fn max_ms(text: &str) -> Result<f64, String> {
    ms_within(text, TIME_BUDGETS_MS)
}

/// Allowed times for a frame's work, milliseconds.
const FRAME_BUDGETS_MS: [f64; 2] = [0.1, 10_000.0];

/// Time for a frame's work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameBudget(pub(super) Budget);

impl FromStr for FrameBudget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let budget = match text {
            "none" => Budget::None,
            "auto" => Budget::ByFrame,
            _ => {
                let ms = ms_within(text, FRAME_BUDGETS_MS);
                let ms = ms.map_err(|why| format!("{why}; or auto, or none"))?;
                Budget::Fixed(Duration::from_secs_f64(ms / 1e3))
            }
        };
        Ok(FrameBudget(budget))
    }
}

/// Where to connect to.
#[derive(Debug, Clone, Args)]
pub(super) struct ServerArgs {
    /// Address of the dataset, http://HOST:PORT/NAME, or https:// for TLS
    #[arg(value_name = "URL")]
    url: Url,
    /// File with the token that opens the dataset; without it, ESCARP_TOKEN has the token itself
    #[arg(long, value_name = "FILE")]
    token: Option<PathBuf>,
    /// Certificates (PEM) to believe in place of the system's, for a server of a private authority
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Most memory for pages, MB: where more would be needed, the tolerance is widened. The GPU's
    /// copy of what is drawn comes on top
    #[arg(long, default_value_t = 1024, value_name = "MB", value_parser = clap::value_parser!(u32).range(16..))]
    memory_mb: u32,
    /// Most memory of the GPU for what is drawn, MB: where more would be needed, the tolerance is
    /// widened; default: no limit
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..))]
    gpu_mb: Option<u32>,
    /// Ask for every page, instead of letting the server send what the view needs
    #[arg(long)]
    pull_only: bool,
    /// Most MB of received pages to keep on disk for later runs, of all datasets together; 0 keeps
    /// and uses none. Default: 256, but 0 for fly
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    cache_mb: Option<u32>,
    /// Folder to keep them in. Default: escarp in $XDG_CACHE_HOME, or in ~/.cache
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Show what is kept on disk, without a server
    #[arg(long)]
    offline: bool,
}

impl ServerArgs {
    /// Begins to connect.
    ///
    /// # Errors
    /// If what is said of the mesh does not go together, or there is no token where one should be.
    pub(super) fn open(&self, mesh: &MeshArgs, budget: FrameBudget) -> Result<RemoteTerrain> {
        let options = ClientOptions {
            memory_cap_bytes: (self.memory_mb as usize).saturating_mul(1 << 20),
            gpu_cap_bytes: self.gpu_mb.map(|mb| u64::from(mb) << 20),
            mesh: mesh.options()?,
            push: !self.pull_only,
            max_ms: mesh.max_ms,
            frame_budget: budget.0,
        };
        let variable = std::env::var(TOKEN_VARIABLE).ok();
        let credentials = Credentials::read(self.token.as_deref(), variable, self.ca.clone())?;
        let url = self.url.clone().with_credentials(credentials);
        let mut terrain = RemoteTerrain::with_options(url, options);
        match self.cache_options()? {
            Some(cache) => terrain.keep_on_disk(cache, &self.url),
            None if self.offline => bail!("--offline needs a cache; give --cache-mb or --cache"),
            None => {}
        }
        if self.offline {
            terrain.stay_offline();
        }
        Ok(terrain)
    }

    /// The same for what is to be measured: without a cache, unless one is asked for.
    pub(super) fn uncached(mut self) -> ServerArgs {
        if self.cache.is_none() && !self.offline {
            self.cache_mb.get_or_insert(0);
        }
        self
    }

    fn cache_options(&self) -> Result<Option<CacheOptions>> {
        let cap_bytes = match self.cache_mb {
            Some(0) => return Ok(None),
            Some(mb) => u64::from(mb) << 20,
            None => DEFAULT_CACHE_BYTES,
        };
        let folder = self.cache.clone().or_else(default_folder);
        Ok(folder.map(|folder| CacheOptions { folder, cap_bytes }))
    }
}

/// How to mesh, and what that may cost.
#[derive(Debug, Clone, Args)]
pub(super) struct MeshArgs {
    /// What decides which triangles are drawn
    #[arg(long, default_value_t, value_parser = meshers())]
    mesher: MesherKind,
    /// What counts as a triangle's error: a bound that holds, or the distance of one vertex
    #[arg(long, default_value_t, value_parser = metrics())]
    metric: Metric,
    /// Ratio of distance to size within which distance and levels split; default: by the tolerance
    #[arg(long, value_name = "R")]
    split_ratio: Option<f64>,
    /// Level of all blocks of levels; default: by distance
    #[arg(long, value_name = "L")]
    level: Option<u8>,
    /// Leave triangles out of sight as they are, for the quadtree by the bounding metric
    #[arg(long)]
    cull: bool,
    /// Let vertices come and go gradually, over this share of the tolerance: off, on, or a share
    /// such as 0.25; for meshers that keep the tolerance. Default: on in a window, else off
    #[arg(long, value_parser = morph, value_name = "off|on|R")]
    morph: Option<f64>,
    /// Most triangles: where there would be more, the tolerance is widened
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(TRIANGLE_BUDGETS[0] as i64..))]
    max_triangles: Option<u32>,
    /// Most milliseconds a frame of updating, triangulating and uploading the mesh: where it would
    /// take longer, the tolerance is widened
    #[arg(long, value_name = "T", value_parser = max_ms)]
    max_ms: Option<f64>,
}

fn morph(text: &str) -> Result<f64, String> {
    let [least, most] = MORPH_SHARES;
    match (text, text.parse::<f64>()) {
        ("off", _) => Ok(0.0),
        ("on", _) => Ok(DEFAULT_MORPH),
        (_, Ok(share)) if share == 0.0 || (least..=most).contains(&share) => Ok(share),
        _ => Err(format!(
            "{text:?}, allowed are off, on, and {least} to {most}"
        )),
    }
}

fn meshers() -> impl TypedValueParser<Value = MesherKind> {
    let names = MesherKind::ALL.iter().map(|kind| kind.name());
    PossibleValuesParser::new(names).try_map(|name| name.parse())
}

fn metrics() -> impl TypedValueParser<Value = Metric> {
    PossibleValuesParser::new(["bounding", "local"]).try_map(|name| name.parse())
}

impl MeshArgs {
    /// The same for what is seen in motion: with a morph, unless something else is said.
    pub(super) fn in_motion(mut self) -> MeshArgs {
        let by_bound = self.mesher.keeps_tolerance() && self.metric == Metric::Bounding;
        if by_bound {
            self.morph.get_or_insert(DEFAULT_MORPH);
        }
        self
    }

    /// What was asked for and has no effect on the mesher.
    fn idle_options(&self) -> Vec<&'static str> {
        let by_bound = self.mesher.keeps_tolerance() && self.metric == Metric::Bounding;
        let by_size = !self.mesher.keeps_tolerance();
        let levels = self.mesher == MesherKind::Levels;
        [
            (self.metric == Metric::Local && by_size, "--metric"),
            (
                self.split_ratio.is_some() && (!by_size || levels && self.level.is_some()),
                "--split-ratio",
            ),
            (self.level.is_some() && !levels, "--level"),
            (
                self.morph.is_some_and(|share| share > 0.0) && !by_bound,
                "--morph",
            ),
            (
                self.cull && !(by_bound && self.mesher == MesherKind::Quadtree),
                "--cull",
            ),
        ]
        .into_iter()
        .filter_map(|(idle, option)| idle.then_some(option))
        .collect()
    }

    /// Says if a mesh had more triangles than were allowed in some frames.
    pub(super) fn report_budget(&self, triangles: impl Iterator<Item = u64>) {
        let Some(most) = self.max_triangles.map(u64::from) else {
            return;
        };
        let (mut frames, mut over, mut largest) = (0, 0, 0);
        for triangles in triangles {
            frames += 1;
            over += usize::from(triangles > most);
            largest = largest.max(triangles);
        }
        if over > 0 {
            eprintln!(
                "warning: more than {most} triangles in {over} of {frames} frames, {largest} at most"
            );
        }
    }

    fn options(&self) -> Result<MeshOptions> {
        for option in self.idle_options() {
            eprintln!(
                "note: {option} has no effect on --mesher {} --metric {}",
                self.mesher, self.metric
            );
        }
        let options = MeshOptions {
            mesher: self.mesher,
            metric: self.metric,
            max_triangles: self.max_triangles,
            max_changes: None,
            split_ratio: self.split_ratio,
            level: self.level,
            cull: self.cull,
            morph: self.morph.unwrap_or(0.0),
        };
        options.check()?;
        let budget = self.max_triangles.is_some() || self.max_ms.is_some();
        let fixed = self.split_ratio.is_some() || self.level.is_some();
        if budget && fixed && !self.mesher.keeps_tolerance() {
            bail!(
                "--max-triangles and --max-ms widen the tolerance, which is of no effect where \
                 --split-ratio or --level is given"
            );
        }
        Ok(options)
    }
}

/// From where to look, and how exactly.
#[derive(Debug, Clone, Args)]
pub(super) struct LookArgs {
    /// Position of the eye; default: a view of the whole
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    eye: Option<Position>,
    /// Position that is looked at; default: the middle of the data
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    look: Option<Position>,
    /// Tolerance: how far the mesh may be from the data on the screen, pixels
    #[arg(long, default_value_t = 2.0, value_parser = error_px, value_name = "P")]
    pub(super) error_px: f32,
    /// Size of the picture, pixels
    #[arg(long, default_value = "1280x720", value_name = "WxH")]
    pub(super) size: Size,
    /// Draw the triangles' edges
    #[arg(long)]
    pub(super) wireframe: bool,
}

impl LookArgs {
    /// What was said of eye and look, if anything.
    pub(super) fn given(&self) -> Option<([f64; 3], [f64; 3])> {
        Some((self.eye?.0, self.look?.0))
    }

    /// Eye and look; what was not said follows from the data.
    pub(super) fn resolve(&self, manifest: &Manifest) -> ([f64; 3], [f64; 3]) {
        let [width, height] = self.size.0;
        let (eye, look) = overview(manifest, FOV_Y, f64::from(width) / f64::from(height));
        (
            self.eye.map_or(eye, |p| p.0),
            self.look.map_or(look, |p| p.0),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Mesh {
        #[command(flatten)]
        mesh: MeshArgs,
    }

    #[test]
    fn options_without_effect_are_named_and_others_are_not() {
        let idle = |words: &str| {
            let words = std::iter::once("mesh").chain(words.split_whitespace());
            Mesh::try_parse_from(words).unwrap().mesh.idle_options()
        };
        assert_eq!(idle("--mesher quadtree --morph on --cull"), [""; 0]);
        assert_eq!(idle("--mesher levels --level 2"), [""; 0]);
        assert_eq!(idle("--mesher distance --split-ratio 3"), [""; 0]);
        assert_eq!(
            idle("--level 2 --split-ratio 3"),
            ["--split-ratio", "--level"]
        );
        assert_eq!(
            idle("--mesher levels --level 2 --split-ratio 3"),
            ["--split-ratio"]
        );
        let all = "--mesher distance --metric local --morph on --cull";
        assert_eq!(idle(all), ["--metric", "--morph", "--cull"]);
        assert_eq!(idle("--mesher roam --cull"), ["--cull"]);
    }

    #[test]
    fn positions_and_sizes_are_read_or_refused_with_the_right_form() {
        assert_eq!("1,-2.5, 3e3".parse(), Ok(Position([1.0, -2.5, 3000.0])));
        assert!("1,2".parse::<Position>().unwrap_err().contains("X,Y,Z"));
        for wrong in ["1,2,NaN", "inf,0,0", "0,1.1e12,0", "0,0,-1e300"] {
            let refusal = wrong.parse::<Position>().unwrap_err();
            assert!(refusal.contains("1e12"), "{refusal}");
        }
        assert!("1e12,-1e12,-0".parse::<Position>().is_ok());
        assert_eq!("640x480".parse(), Ok(Size([640, 480])));
        assert!("640".parse::<Size>().unwrap_err().contains("WxH"));
        assert!("0x480".parse::<Size>().is_err());
        assert!(error_px("0").unwrap_err().contains("allowed"));
        assert_eq!(error_px("1.5"), Ok(1.5));
    }

    #[test]
    fn options_of_the_mesh_that_do_not_go_together_are_refused() {
        #[derive(clap::Parser)]
        struct Only {
            #[command(flatten)]
            mesh: MeshArgs,
        }
        let parse = |line: &str| {
            let words = std::iter::once("mesh").chain(line.split_whitespace());
            let only = <Only as clap::Parser>::try_parse_from(words);
            only.map_err(|error| error.to_string())
                .and_then(|only| only.mesh.options().map_err(|error| error.to_string()))
        };
        assert_eq!(parse(""), Ok(MeshOptions::default()));
        for kind in MesherKind::ALL {
            let options = parse(&format!("--mesher {kind} --metric local")).unwrap();
            assert_eq!((options.mesher, options.metric), (*kind, Metric::Local));
        }
        let refusal = |line: &str| parse(line).unwrap_err();
        assert!(refusal("--mesher fans").contains("quadtree"));
        assert!(refusal("--metric far").contains("bounding"));
        assert!(refusal("--morph nan").contains("0.01 to 4"));
        assert_eq!(parse("--morph on").unwrap().morph, DEFAULT_MORPH);
        assert_eq!(parse("--morph off"), Ok(MeshOptions::default()));
        assert!(refusal("--max-triangles 0").contains("16"));
        assert!(refusal("--max-ms NaN").contains("allowed"));
        assert!(refusal("--split-ratio NaN").contains("allowed"));
        assert!(refusal("--split-ratio inf").contains("allowed"));
        assert!(refusal("--level 9").contains("allowed"));
        assert!(refusal("--mesher levels --level 2 --max-triangles 5000").contains("--level"));
    }

    #[test]
    fn budgets_that_make_no_sense_are_refused_with_what_is_allowed() {
        for wrong in [
            "NaN", "inf", "-inf", "0", "-0", "1e-320", "-5", "1e300", "fast",
        ] {
            for refusal in [
                error_px(wrong).unwrap_err(),
                max_ms(wrong).unwrap_err(),
                wrong.parse::<FrameBudget>().unwrap_err(),
            ] {
                let says = refusal.contains("allowed") || refusal.contains("no number");
                assert!(says, "{wrong}: {refusal}");
            }
        }
        assert_eq!("none".parse(), Ok(FrameBudget(Budget::None)));
        assert_eq!("auto".parse(), Ok(FrameBudget(Budget::ByFrame)));
        let eight = Duration::from_millis(8);
        assert_eq!("8".parse(), Ok(FrameBudget(Budget::Fixed(eight))));
        assert_eq!(max_ms("2.5"), Ok(2.5));
    }
}
