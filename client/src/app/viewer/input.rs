//! Keys and mouse.

use crate::camera::Controls;
use std::collections::HashSet;
use winit::event::{ElementState, KeyEvent, MouseButton, MouseScrollDelta};
use winit::keyboard::{KeyCode, PhysicalKey};

/// Pixels of a smooth wheel that count as a notch.
const NOTCH_PX: f64 = 40.0;

/// What the help says.
pub const HELP: [(&str, &str); 12] = [
    ("W A S D, arrows", "fly ahead, left, back, right"),
    ("E, Space / C", "rise / sink"),
    ("Shift", "four times as fast"),
    ("drag", "look around"),
    ("wheel, + -", "faster, slower"),
    ("R, Home", "back to the start"),
    ("O", "overview"),
    ("X, F2", "wireframe"),
    ("[ ]", "tolerance down, up"),
    ("F12", "save the picture as PNG"),
    ("H, F1", "this help"),
    ("Q, Esc", "quit"),
];

/// What a key does once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    Quit,
    ToggleHelp,
    ToggleWireframe,
    Screenshot,
    Home,
    Overview,
    Faster,
    Slower,
    FinerTolerance,
    CoarserTolerance,
}

/// Which keys are held, and where the mouse drags.
#[derive(Debug, Default)]
pub struct Input {
    held: HashSet<KeyCode>,
    dragging: bool,
    pointer: Option<[f64; 2]>,
}

impl Input {
    /// Takes a key; returns what it does once.
    pub fn key(&mut self, event: &KeyEvent) -> Option<Command> {
        let PhysicalKey::Code(code) = event.physical_key else {
            return None;
        };
        if event.state == ElementState::Released {
            self.held.remove(&code);
            return None;
        }
        self.held.insert(code);
        command(code).filter(|_| !event.repeat || is_repeatable(code))
    }

    /// Takes a mouse button.
    pub fn button(&mut self, button: MouseButton, state: ElementState) {
        if matches!(button, MouseButton::Left | MouseButton::Right) {
            self.dragging = state == ElementState::Pressed;
        }
    }

    /// Takes the pointer's new place; returns how far it dragged right and down, pixels.
    pub fn pointer(&mut self, x: f64, y: f64) -> Option<[f64; 2]> {
        let before = self.pointer.replace([x, y])?;
        self.dragging.then(|| [x - before[0], y - before[1]])
    }

    /// Lets go of everything: the window lost the keyboard, and will not hear of releases.
    pub fn release(&mut self) {
        *self = Input::default();
    }

    /// What the held keys ask for.
    pub fn controls(&self) -> Controls {
        use KeyCode::*;
        let any =
            |keys: &[KeyCode]| f64::from(u8::from(keys.iter().any(|key| self.held.contains(key))));
        Controls {
            forward: any(&[KeyW, ArrowUp]) - any(&[KeyS, ArrowDown]),
            right: any(&[KeyD, ArrowRight]) - any(&[KeyA, ArrowLeft]),
            up: any(&[KeyE, Space, PageUp]) - any(&[KeyC, PageDown]),
            hurry: any(&[ShiftLeft, ShiftRight]) > 0.0,
        }
    }
}

/// Notches that a wheel turned.
pub fn notches(delta: MouseScrollDelta) -> f64 {
    match delta {
        MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
        MouseScrollDelta::PixelDelta(pixels) => pixels.y / NOTCH_PX,
    }
}

fn command(code: KeyCode) -> Option<Command> {
    Some(match code {
        KeyCode::Escape | KeyCode::KeyQ => Command::Quit,
        KeyCode::KeyH | KeyCode::F1 => Command::ToggleHelp,
        KeyCode::KeyX | KeyCode::F2 => Command::ToggleWireframe,
        KeyCode::F12 => Command::Screenshot,
        KeyCode::KeyR | KeyCode::Home => Command::Home,
        KeyCode::KeyO => Command::Overview,
        KeyCode::Equal | KeyCode::NumpadAdd => Command::Faster,
        KeyCode::Minus | KeyCode::NumpadSubtract => Command::Slower,
        KeyCode::BracketLeft => Command::FinerTolerance,
        KeyCode::BracketRight => Command::CoarserTolerance,
        _ => return None,
    })
}

fn is_repeatable(code: KeyCode) -> bool {
    use KeyCode::*;
    matches!(
        code,
        Equal | Minus | NumpadAdd | NumpadSubtract | BracketLeft | BracketRight
    )
}
