//! The window: fly through the terrain of a client.
//!
//! It draws while something moves or loads, and rests otherwise.

mod input;
mod session;
mod ui;

use super::{TerrainClient, Waker};
use crate::render::{GpuError, Presented};
use session::Session;
use std::sync::Arc;
use std::time::{Duration, Instant};
use thiserror::Error;
use winit::application::ApplicationHandler;
use winit::error::{EventLoopError, OsError};
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::WindowId;

/// How often a resting viewer asks its client for news.
const REST: Duration = Duration::from_millis(500);
/// How soon a picture that the window could not take is tried again.
const RETRY: Duration = Duration::from_millis(20);

/// How the viewer begins.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewerOptions {
    /// Title of the window.
    pub title: String,
    /// Size of the window, logical pixels.
    pub size: [u32; 2],
    /// Tolerance, pixels.
    pub error_px: f32,
    /// Samples a pixel: 1 or 4.
    pub samples: u32,
    /// Whether triangles' edges are drawn.
    pub wireframe: bool,
    /// Where to begin and what to look at, metres; the overview if it is not said.
    pub start: Option<([f64; 3], [f64; 3])>,
}

impl Default for ViewerOptions {
    fn default() -> Self {
        ViewerOptions {
            title: "Escarp".into(),
            size: [1280, 720],
            error_px: 2.0,
            samples: 1,
            wireframe: false,
            start: None,
        }
    }
}

/// Why the viewer ended early.
#[derive(Debug, Error)]
pub enum ViewerError {
    /// There is no display, or it went away.
    #[error("no window can be shown (is DISPLAY or WAYLAND_DISPLAY set?)")]
    EventLoop(#[from] EventLoopError),
    /// The display refused a window.
    #[error("the window cannot be opened")]
    Window(#[from] OsError),
    /// Nothing can be drawn in it.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// Shows a client's terrain until the window is closed. Must be called on the main thread.
///
/// # Errors
/// If there is no display, no window, or no way to draw in it.
pub fn run(client: impl TerrainClient, options: ViewerOptions) -> Result<(), ViewerError> {
    let events = EventLoop::<News>::with_user_event().build()?;
    let mut viewer = Viewer::new(client, options, events.create_proxy());
    events.run_app(&mut viewer)?;
    viewer.outcome
}

/// Something has arrived for the client.
#[derive(Debug, Clone, Copy)]
struct News;

struct Viewer<C> {
    client: C,
    options: ViewerOptions,
    began: Instant,
    session: Option<Session>,
    outcome: Result<(), ViewerError>,
}

impl<C: TerrainClient> Viewer<C> {
    fn new(mut client: C, options: ViewerOptions, proxy: EventLoopProxy<News>) -> Viewer<C> {
        let waker: Waker = Arc::new(move || {
            // The loop may have ended already; then there is nobody to wake.
            let _ = proxy.send_event(News);
        });
        client.set_waker(waker);
        Viewer {
            client,
            options,
            began: Instant::now(),
            session: None,
            outcome: Ok(()),
        }
    }

    fn end(&mut self, events: &ActiveEventLoop, outcome: Result<(), ViewerError>) {
        self.outcome = outcome;
        self.session = None;
        events.exit();
    }

    fn redraw(&mut self, events: &ActiveEventLoop) {
        let Some(session) = &mut self.session else {
            return;
        };
        match session.frame(&mut self.client, self.began.elapsed()) {
            Ok(Presented::Shown(_)) if session.is_busy() => {
                events.set_control_flow(ControlFlow::Wait);
                session.window().request_redraw();
            }
            Ok(Presented::Retry) => events.set_control_flow(ControlFlow::wait_duration(RETRY)),
            Ok(_) => events.set_control_flow(ControlFlow::wait_duration(REST)),
            Err(error) => self.end(events, Err(error.into())),
        }
    }

    /// After a rest: draws if there is something new to show, and rests on if not.
    fn look_for_news(&mut self, events: &ActiveEventLoop) {
        let Some(session) = &mut self.session else {
            return;
        };
        if session.has_news(&mut self.client, self.began.elapsed()) {
            events.set_control_flow(ControlFlow::Wait);
            session.window().request_redraw();
        } else {
            events.set_control_flow(ControlFlow::wait_duration(REST));
        }
    }
}

impl<C: TerrainClient> ApplicationHandler<News> for Viewer<C> {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.session.is_some() {
            return;
        }
        match Session::open(events, &self.options) {
            Ok(session) => {
                session.window().request_redraw();
                self.session = Some(session);
            }
            Err(error) => self.end(events, Err(error)),
        }
    }

    fn new_events(&mut self, events: &ActiveEventLoop, cause: StartCause) {
        if let StartCause::ResumeTimeReached { .. } = cause {
            self.look_for_news(events);
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, _: News) {
        if let Some(session) = &self.session {
            session.window().request_redraw();
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(session) = &mut self.session else {
            return;
        };
        match event {
            WindowEvent::CloseRequested => self.end(events, Ok(())),
            WindowEvent::RedrawRequested => self.redraw(events),
            event => {
                if session.handle(&event) {
                    self.end(events, Ok(()));
                }
            }
        }
    }
}
