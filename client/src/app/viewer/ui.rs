//! What is written over the picture.

use super::input::HELP;
use crate::app::StepStats;
use crate::mesh::{BLOCK_LEVELS, DEFAULT_MORPH, MeshOptions, MesherKind, Metric};
use crate::render::DrawStats;
use egui::{Align2, Color32, ComboBox, Frame, RichText, Slider, Ui, Window};

/// Range of the tolerance slider, pixels.
pub const TOLERANCES_PX: [f32; 2] = [0.5, 32.0];
/// Range of the exaggeration slider.
const EXAGGERATIONS: [f32; 2] = [0.5, 5.0];

/// What the user can set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    pub error_px: f32,
    pub exaggeration: f32,
    pub wireframe: bool,
    pub help: bool,
    pub mesh: MeshOptions,
}

impl Settings {
    /// Keeps what was set before in place of numbers that are none, as can be typed into a slider.
    pub fn put_in_order(&mut self, before: &Settings) {
        let usable = |value: f32, before: f32, [least, most]: [f32; 2]| match value.is_nan() {
            true => before,
            false => value.clamp(least, most),
        };
        // A tolerance from the command line may be beyond the slider's range.
        if self.error_px != before.error_px {
            self.error_px = usable(self.error_px, before.error_px, TOLERANCES_PX);
        }
        self.exaggeration = usable(self.exaggeration, before.exaggeration, EXAGGERATIONS);
    }
}

/// What the user is told.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Facts {
    pub status: String,
    pub step: StepStats,
    pub drawn: DrawStats,
    /// What a frame takes, on average, milliseconds.
    pub frame_ms: f32,
    /// What bringing the GPU up to date took, and drawing, milliseconds.
    pub upload_ms: f32,
    pub draw_ms: f32,
    /// What had to be changed of the view.
    pub notes: Vec<String>,
    pub above_ground_m: Option<f64>,
    pub speed_m_s: f64,
    /// The newest message, such as where a picture was saved.
    pub message: String,
}

/// Lays it all out.
pub fn show(ui: &mut Ui, settings: &mut Settings, facts: &Facts) {
    let panel = panel(ui);
    Window::new("status")
        .title_bar(false)
        .resizable(false)
        .anchor(Align2::LEFT_TOP, [10.0, 10.0])
        .frame(panel)
        .show(ui.ctx(), |ui| {
            brighten(ui);
            status(ui, facts, settings);
            ui.add_space(4.0);
            controls(ui, settings);
        });
    if settings.help {
        Window::new("help")
            .title_bar(false)
            .resizable(false)
            .anchor(Align2::RIGHT_TOP, [-10.0, 10.0])
            .frame(panel)
            .show(ui.ctx(), help);
    }
}

/// A dark pane that lets the picture through, but not so much that the text suffers.
fn panel(ui: &Ui) -> Frame {
    Frame::window(ui.style())
        .fill(Color32::from_rgba_unmultiplied(14, 18, 26, 214))
        .stroke(egui::Stroke::NONE)
        .shadow(egui::Shadow::NONE)
}

/// Text and rails that can be read on the pane.
fn brighten(ui: &mut Ui) {
    ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
    let visuals = ui.visuals_mut();
    visuals.override_text_color = Some(Color32::from_gray(222));
    visuals.widgets.inactive.bg_fill = Color32::from_gray(84);
    visuals.widgets.inactive.weak_bg_fill = Color32::from_gray(56);
}

fn status(ui: &mut Ui, facts: &Facts, settings: &Settings) {
    let (step, drawn) = (&facts.step, &facts.drawn);
    ui.label(bound(step, settings));
    ui.label(format!(
        "{} triangles ({} drawn)   {:.1} ms a frame",
        thousands(step.triangles),
        thousands(drawn.triangles_drawn),
        facts.frame_ms,
    ));
    let times = &step.times;
    ui.label(format!(
        "ms: decode {:.2}  link {:.2}  update {:.2}  triangulate {:.2}  upload {:.2}  draw {:.2}",
        times.decode_ms,
        times.link_ms,
        times.update_ms,
        times.triangulate_ms,
        facts.upload_ms,
        facts.draw_ms
    ));
    ui.label(format!(
        "{} received   pages: {} resident, {} wanted, {} in flight, {} waiting",
        bytes(step.bytes_received),
        step.pages_resident,
        step.pages_wanted,
        step.pages_in_flight,
        step.chunks_waiting
    ));
    let above = facts.above_ground_m.map_or("—".into(), metres);
    ui.label(format!(
        "{above} above ground   {}/s at full speed",
        metres(facts.speed_m_s)
    ));
    ui.label(facts.status.clone());
    for note in facts.notes.iter().chain(Some(&facts.message)) {
        if !note.is_empty() {
            ui.label(RichText::new(note).color(Color32::from_rgb(255, 214, 120)));
        }
    }
}

/// The level of all blocks, or by distance.
fn level(ui: &mut Ui, level: &mut Option<u8>) {
    let name = |level: Option<u8>| level.map_or("by distance".into(), |n| format!("level {n}"));
    let shown = ComboBox::from_id_salt("level").selected_text(name(*level));
    shown.show_ui(ui, |ui| {
        let levels = (BLOCK_LEVELS[0]..=BLOCK_LEVELS[1]).map(Some);
        for choice in std::iter::once(None).chain(levels) {
            ui.selectable_value(level, choice, name(choice));
        }
    });
}

/// The error bound against the tolerance: green within it, amber while loading.
fn bound(step: &StepStats, settings: &Settings) -> RichText {
    let found = if step.bound_px.is_finite() {
        format!("{:.2} px", step.bound_px)
    } else {
        "∞".into()
    };
    let state = if step.converged { "" } else { ", loading" };
    let scale = if settings.exaggeration == 1.0 {
        ""
    } else {
        ", at true heights"
    };
    let widened = match step.tolerance_px > settings.error_px {
        true => format!(", widened to {:.2} px by the budget", step.tolerance_px),
        false => String::new(),
    };
    let text = format!(
        "error at most {found}, tolerance {:.2} px{widened}{scale}{state}",
        settings.error_px
    );
    let within = step.bound_px <= f64::from(settings.error_px);
    let colour = if within {
        Color32::from_rgb(140, 230, 150)
    } else {
        Color32::from_rgb(255, 190, 90)
    };
    RichText::new(text).strong().color(colour)
}

fn controls(ui: &mut Ui, settings: &mut Settings) {
    let [least, most] = TOLERANCES_PX;
    let tolerance = Slider::new(&mut settings.error_px, least..=most)
        .logarithmic(true)
        .suffix(" px")
        .text("tolerance");
    ui.add(tolerance);
    let [least, most] = EXAGGERATIONS;
    let heights = Slider::new(&mut settings.exaggeration, least..=most)
        .logarithmic(true)
        .fixed_decimals(1)
        .prefix("x")
        .text("heights");
    ui.add(heights);
    ui.horizontal(|ui| {
        ui.checkbox(&mut settings.wireframe, "wireframe");
        ui.checkbox(&mut settings.help, "help");
    });
    mesh(ui, &mut settings.mesh);
}

/// Which mesher, by which errors.
fn mesh(ui: &mut Ui, mesh: &mut MeshOptions) {
    ui.horizontal(|ui| {
        let shown = ComboBox::from_id_salt("mesher").selected_text(mesh.mesher.name());
        shown.show_ui(ui, |ui| {
            for &kind in MesherKind::ALL {
                ui.selectable_value(&mut mesh.mesher, kind, kind.name());
            }
        });
        let shown = ComboBox::from_id_salt("metric").selected_text(mesh.metric.to_string());
        shown.show_ui(ui, |ui| {
            for metric in [Metric::Bounding, Metric::Local] {
                ui.selectable_value(&mut mesh.metric, metric, metric.to_string());
            }
        });
        if mesh.mesher == MesherKind::Levels {
            level(ui, &mut mesh.level);
        }
        ui.label("mesher, metric");
        let mut morph = mesh.morph > 0.0;
        if ui.checkbox(&mut morph, "morph").changed() {
            mesh.morph = if morph { DEFAULT_MORPH } else { 0.0 };
        }
    });
}

fn help(ui: &mut Ui) {
    brighten(ui);
    egui::Grid::new("keys").num_columns(2).show(ui, |ui| {
        for (key, action) in HELP {
            ui.label(RichText::new(key).strong());
            ui.label(action);
            ui.end_row();
        }
    });
}

/// A number with its thousands apart.
fn thousands(n: u64) -> String {
    let digits = n.to_string();
    let groups = digits.as_bytes().rchunks(3).rev();
    let groups: Vec<_> = groups.map(String::from_utf8_lossy).collect();
    groups.join(" ")
}

fn bytes(n: u64) -> String {
    match n {
        0..1_000 => format!("{n} B"),
        1_000..1_000_000 => format!("{:.1} kB", n as f64 / 1e3),
        _ => format!("{:.2} MB", n as f64 / 1e6),
    }
}

fn metres(m: f64) -> String {
    match m.abs() {
        m if m >= 10_000.0 => format!("{:.0} km", m / 1e3),
        m if m >= 1_000.0 => format!("{:.1} km", m / 1e3),
        m if m >= 10.0 => format!("{m:.0} m"),
        _ => format!("{m:.1} m"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_typed_into_a_slider_is_put_in_order() {
        let before = Settings {
            error_px: 40.0,
            exaggeration: 2.0,
            wireframe: false,
            help: false,
            mesh: MeshOptions::default(),
        };
        let typed = |error_px, exaggeration| {
            let mut settings = Settings {
                error_px,
                exaggeration,
                ..before
            };
            settings.put_in_order(&before);
            [settings.error_px, settings.exaggeration]
        };
        assert_eq!(typed(f32::NAN, f32::NAN), [40.0, 2.0]);
        assert_eq!(typed(40.0, 2.0), [40.0, 2.0]);
        assert_eq!(typed(f32::INFINITY, f32::NEG_INFINITY), [32.0, 0.5]);
        assert_eq!(typed(-0.0, 0.0), [0.5, 0.5]);
        assert_eq!(typed(f32::MAX, f32::MIN_POSITIVE), [32.0, 0.5]);
    }

    #[test]
    fn figures_are_readable() {
        assert_eq!(thousands(7), "7");
        assert_eq!(thousands(1_234_567), "1 234 567");
        assert_eq!(
            [bytes(12), bytes(1234), bytes(12_345_678)],
            ["12 B", "1.2 kB", "12.35 MB"]
        );
        assert_eq!(
            [metres(0.5), metres(1500.0), metres(25_000.0)],
            ["0.5 m", "1.5 km", "25 km"]
        );
    }
}
