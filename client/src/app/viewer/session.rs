//! An open window: input, camera, client, picture, in this order, frame by frame.

use super::input::{Command, Input, notches};
use super::ui::{Facts, Settings, TOLERANCES_PX, show};
use super::{ViewerError, ViewerOptions};
use crate::app::{GroundProbe, StepStats, TerrainClient};
use crate::camera::{DEFAULT_FOV_Y, FlyCamera, overview};
use crate::mesh::MeshOptions;
use crate::render::{DrawParams, GpuError, Headless, Presented, Scene, UiFrame, WindowTarget};
use crate::stages::StageTimes;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::View;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use winit::dpi::LogicalSize;
use winit::event::WindowEvent;
use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

/// Share of the newest frame in the average that is shown.
const FRAME_MS_SHARE: f32 = 0.1;
/// Factor on the tolerance of one key press.
const TOLERANCE_STEP: f32 = 1.189_207_1;
/// How long a message is shown.
const MESSAGE_TIME: Duration = Duration::from_secs(6);

/// An open window.
pub struct Session {
    window: Arc<Window>,
    target: WindowTarget,
    egui: egui_winit::State,
    input: Input,
    settings: Settings,
    facts: Facts,
    /// What there is once the manifest is known.
    world: Option<World>,
    start: Option<([f64; 3], [f64; 3])>,
    last: Option<Duration>,
    message_until: Duration,
    /// When the user interface wants to be drawn again.
    repaint_at: Option<Duration>,
    /// Whether the last picture was not shown, and must be drawn again.
    stale: bool,
    screenshot_due: bool,
    unsettled: bool,
}

struct World {
    manifest: Arc<Manifest>,
    scene: Scene,
    camera: FlyCamera,
    ground_m: Option<f64>,
}

impl Session {
    pub fn open(events: &ActiveEventLoop, options: &ViewerOptions) -> Result<Session, ViewerError> {
        let [width, height] = options.size;
        let attributes = Window::default_attributes()
            .with_title(&options.title)
            .with_inner_size(LogicalSize::new(width, height));
        let window = Arc::new(events.create_window(attributes)?);
        let display = events.owned_display_handle();
        let target = WindowTarget::new(Arc::clone(&window), display, options.samples)?;
        let egui = egui_winit::State::new(
            egui::Context::default(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            None,
            Some(target.gpu().max_side_px() as usize),
        );
        egui.egui_ctx().set_theme(egui::Theme::Dark);
        Ok(Session {
            settings: Settings {
                error_px: options.error_px,
                exaggeration: 1.0,
                wireframe: options.wireframe,
                help: true,
                mesh: MeshOptions::default(),
            },
            facts: Facts::default(),
            input: Input::default(),
            world: None,
            start: options.start,
            last: None,
            message_until: Duration::ZERO,
            repaint_at: None,
            stale: true,
            screenshot_due: false,
            unsettled: true,
            window,
            target,
            egui,
        })
    }

    pub fn window(&self) -> &Window {
        &self.window
    }

    /// Whether the next picture will differ from this one.
    pub fn is_busy(&self) -> bool {
        let moving = self
            .world
            .as_ref()
            .is_some_and(|world| world.camera.is_moving());
        let now = self.last.unwrap_or_default();
        moving
            || self.unsettled
            || self.screenshot_due
            || self.repaint_at.is_some_and(|at| at <= now)
    }

    /// Whether a viewer that rested has something new to show. Steps the client.
    pub fn has_news(&mut self, client: &mut impl TerrainClient, now: Duration) -> bool {
        let message_is_over = !self.facts.message.is_empty() && now > self.message_until;
        let repaint = self.repaint_at.is_some_and(|at| at <= now);
        if self.stale || message_is_over || repaint || client.status() != self.facts.status {
            return true;
        }
        match (&self.world, self.target.size_px()) {
            (Some(world), Some(size)) => {
                let view = world.camera.view(size, self.settings.error_px);
                step_differs(&client.step(&view, now), &self.facts.step)
            }
            (None, _) => {
                client.poll(now);
                client.manifest().is_some()
            }
            (_, None) => false,
        }
    }

    /// Takes an event of the window; returns whether the user wants to quit.
    pub fn handle(&mut self, event: &WindowEvent) -> bool {
        let answer = self.egui.on_window_event(&self.window, event);
        if answer.repaint {
            self.window.request_redraw();
        }
        match event {
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } => {
                let size = self.window.inner_size();
                self.target.resize([size.width, size.height]);
                self.window.request_redraw();
            }
            WindowEvent::Focused(false) => self.input.release(),
            WindowEvent::Occluded(false) => self.window.request_redraw(),
            WindowEvent::KeyboardInput { event, .. } => {
                // A slider that is being typed in takes letters, but no release is ever missed.
                let typed = self.egui.egui_ctx().text_edit_focused();
                let pressed = event.state.is_pressed();
                let command = if typed && pressed {
                    None
                } else {
                    self.input.key(event)
                };
                self.window.request_redraw();
                return command.is_some_and(|command| self.obey(command));
            }
            // A press on the user interface is not ours; a release ends our drag wherever it is.
            WindowEvent::MouseInput { state, button, .. }
                if !(answer.consumed && state.is_pressed()) =>
            {
                self.input.button(*button, *state);
            }
            WindowEvent::MouseWheel { delta, .. } if !answer.consumed => {
                self.change_pace(notches(*delta));
            }
            WindowEvent::CursorMoved { position, .. } => {
                if let Some([right, down]) = self.input.pointer(position.x, position.y) {
                    self.drag(right, down);
                }
            }
            _ => {}
        }
        false
    }

    fn drag(&mut self, right_px: f64, down_px: f64) {
        let height = f64::from(self.window.inner_size().height);
        if let Some(world) = &mut self.world {
            world.camera.drag(right_px, down_px, height);
            self.window.request_redraw();
        }
    }

    fn change_pace(&mut self, notches: f64) {
        if let Some(world) = &mut self.world {
            world.camera.change_pace(notches);
            self.window.request_redraw();
        }
    }

    /// Does what a key says; returns whether that is to quit.
    fn obey(&mut self, command: Command) -> bool {
        let settings = &mut self.settings;
        let [least, most] = TOLERANCES_PX;
        match command {
            Command::Quit => return true,
            Command::ToggleHelp => settings.help = !settings.help,
            Command::ToggleWireframe => settings.wireframe = !settings.wireframe,
            Command::Screenshot => self.screenshot_due = true,
            Command::FinerTolerance => {
                settings.error_px = (settings.error_px / TOLERANCE_STEP).clamp(least, most);
            }
            Command::CoarserTolerance => {
                settings.error_px = (settings.error_px * TOLERANCE_STEP).clamp(least, most);
            }
            Command::Faster => self.change_pace(1.0),
            Command::Slower => self.change_pace(-1.0),
            Command::Home => {
                if let Some(world) = &mut self.world {
                    world.camera.go_home();
                }
            }
            Command::Overview => {
                let aspect = self.aspect();
                if let Some(world) = &mut self.world {
                    let (eye, look) = overview(&world.manifest, world.camera.fov_y, aspect);
                    world.camera.jump(eye, look);
                }
            }
        }
        false
    }

    /// One frame: camera, client, picture.
    pub fn frame(
        &mut self,
        client: &mut impl TerrainClient,
        now: Duration,
    ) -> Result<Presented, GpuError> {
        let began = Instant::now();
        let elapsed = now - self.last.replace(now).unwrap_or(now);
        if now > self.message_until {
            self.facts.message.clear();
        }
        if self.world.is_none() {
            client.poll(now);
        }
        self.enter_world(client);
        self.facts.status = client.status();
        self.settings.mesh = client.mesh_options();
        if let Some(size) = self.target.size_px() {
            self.advance(client, size, now, elapsed);
        }
        self.save_screenshot(now);
        let ui = self.lay_out(now);
        client.set_mesh_options(self.settings.mesh);
        let params = self.params();
        let scene = self.world.as_mut().map(|world| &mut world.scene);
        let present_began = Instant::now();
        let presented = self.target.present(scene.zip(params.as_ref()), ui)?;
        self.stale = presented == Presented::Retry;
        if let Presented::Shown(drawn) = presented {
            self.facts.drawn = drawn;
            let ms = began.elapsed().as_secs_f32() * 1e3;
            self.facts.frame_ms += (ms - self.facts.frame_ms) * FRAME_MS_SHARE;
            self.facts.draw_ms = present_began.elapsed().as_secs_f32() * 1e3;
            client.shown(ms - self.facts.step.times.total_ms());
        }
        Ok(presented)
    }

    /// Sets up scene and camera when the manifest comes, and anew when another one comes.
    fn enter_world(&mut self, client: &impl TerrainClient) {
        let Some(manifest) = client.manifest() else {
            return;
        };
        let known = self.world.as_ref().map(|world| &world.manifest);
        if known.is_some_and(|known| Arc::ptr_eq(known, &manifest) || *known == manifest) {
            return;
        }
        let (eye, look) = self
            .start
            .unwrap_or_else(|| overview(&manifest, DEFAULT_FOV_Y, self.aspect()));
        let camera = match self.world.take() {
            Some(world) => world.camera,
            None => FlyCamera::new(eye, look, DEFAULT_FOV_Y),
        };
        let (gpu, output) = (self.target.gpu(), self.target.output());
        self.world = Some(World {
            scene: Scene::new(gpu, &manifest.georef, manifest.height_range, output),
            camera,
            ground_m: None,
            manifest,
        });
    }

    fn aspect(&self) -> f64 {
        let [width, height] = self.target.size_px().unwrap_or([16, 9]);
        f64::from(width) / f64::from(height)
    }

    /// Flies, steps the client, and brings the scene up to date.
    fn advance(
        &mut self,
        client: &mut impl TerrainClient,
        size: [u32; 2],
        now: Duration,
        elapsed: Duration,
    ) {
        let Some(world) = &mut self.world else {
            return;
        };
        let exaggeration = f64::from(self.settings.exaggeration);
        let above = world.above_ground_m(exaggeration);
        let controls = self.input.controls();
        world.camera.step(&controls, above, elapsed.as_secs_f64());
        world.stay_above_ground(exaggeration);
        let view = world.camera.view(size, self.settings.error_px);
        let step = client.step(&view, now);
        // It may have come to a generation whose pages lie elsewhere.
        self.enter_world(client);
        let Some(world) = &mut self.world else {
            return;
        };
        self.facts.notes.clear();
        self.facts.notes.extend_from_slice(client.notes());
        let began = Instant::now();
        world.sync(client, &view.clamped().0);
        self.facts.upload_ms = began.elapsed().as_secs_f32() * 1e3;
        client.uploaded(self.facts.upload_ms);
        let loading = !step.converged || !step.steady || step.chunks_waiting > 0;
        self.unsettled = loading || step_differs(&step, &self.facts.step);
        self.facts.step = step;
        self.facts.above_ground_m = world.ground_m.map(|_| world.above_ground_m(exaggeration));
        self.facts.speed_m_s = world.camera.speed_m_s(above);
    }

    fn params(&self) -> Option<DrawParams> {
        let (world, size) = (self.world.as_ref()?, self.target.size_px()?);
        let view = world.camera.view(size, self.settings.error_px);
        let params = DrawParams {
            wireframe: self.settings.wireframe,
            exaggeration: self.settings.exaggeration,
            ..DrawParams::new(view)
        };
        Some(params.clamped().0)
    }

    fn lay_out(&mut self, now: Duration) -> UiFrame {
        let input = self.egui.take_egui_input(&self.window);
        let context = self.egui.egui_ctx().clone();
        let (settings, facts) = (&mut self.settings, &self.facts);
        let before = *settings;
        let output = context.run_ui(input, |ui| show(ui, settings, facts));
        settings.put_in_order(&before);
        self.unsettled |= before != *settings;
        self.egui
            .handle_platform_output(&self.window, output.platform_output);
        let root = output.viewport_output.get(&egui::ViewportId::ROOT);
        self.repaint_at = root.and_then(|root| now.checked_add(root.repaint_delay));
        UiFrame {
            primitives: context.tessellate(output.shapes, output.pixels_per_point),
            textures: output.textures_delta,
            pixels_per_point: output.pixels_per_point,
        }
    }

    fn save_screenshot(&mut self, now: Duration) {
        if !std::mem::take(&mut self.screenshot_due) {
            return;
        }
        self.facts.message = match self.screenshot() {
            Ok(path) => format!("saved {}", path.display()),
            Err(reason) => format!("no picture saved: {reason}"),
        };
        self.message_until = now + MESSAGE_TIME;
    }

    fn screenshot(&mut self) -> Result<PathBuf, String> {
        let params = self.params().ok_or("there is no terrain yet")?;
        let world = self.world.as_mut().ok_or("there is no terrain yet")?;
        let (gpu, size) = (self.target.gpu(), params.view.viewport_px);
        let (image, _) = Headless::of(gpu, size, world.scene.output())
            .and_then(|mut target| target.render(&mut world.scene, &params))
            .map_err(|error| error.to_string())?;
        let folder = std::env::current_dir().map_err(|error| error.to_string())?;
        let path = (1..10_000)
            .map(|n| folder.join(format!("escarp-{n:04}.png")))
            .find(|path| !path.exists())
            .ok_or("there are 9999 pictures here already")?;
        image.save(&path).map_err(|error| error.to_string())?;
        Ok(path)
    }
}

impl World {
    /// Height of the eye over the ground as drawn; over the lowest ground where there is none.
    fn above_ground_m(&self, exaggeration: f64) -> f64 {
        let [_, _, [lowest, _]] = self.manifest.extent_m();
        let ground = self.ground_m.unwrap_or(lowest) * exaggeration;
        (self.camera.eye_m.z - ground).max(self.clearance_m())
    }

    fn clearance_m(&self) -> f64 {
        let [dx, dy] = self.manifest.georef.sample_spacing_m;
        (dx.min(dy) * 0.1).clamp(0.01, 5.0)
    }

    fn stay_above_ground(&mut self, exaggeration: f64) {
        if let Some(ground) = self.ground_m {
            self.camera
                .stay_above(ground * exaggeration + self.clearance_m());
        }
    }

    fn sync(&mut self, client: &impl TerrainClient, view: &View) {
        let [x, y, _] = view.eye_m;
        let mut probe = GroundProbe::new(&self.manifest.georef, [x, y]);
        let mut sync = self.scene.begin_sync();
        client.visit_pages(&mut |mesh| {
            probe.visit(mesh);
            sync.keep(mesh);
        });
        sync.end();
        self.ground_m = probe.height_m();
    }
}

/// Whether anything but the time it took differs.
fn step_differs(a: &StepStats, b: &StepStats) -> bool {
    let times = StageTimes::default();
    StepStats { times, ..*a } != StepStats { times, ..*b }
}
