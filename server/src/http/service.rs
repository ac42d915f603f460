//! From a connection's requests to their answers: what is at hand is answered on the spot, all
//! else by the router.

use super::{App, data, router};
use axum::Router;
use axum::http::{HeaderMap, Request};
use axum::response::Response;
use futures_util::future::Either;
use hyper::body::Incoming;
use hyper_util::service::{TowerToHyperService, TowerToHyperServiceFuture};
use std::convert::Infallible;
use std::future::{Ready, ready};

/// Whether a request may be answered on the spot, past whatever the router is wrapped in.
pub(crate) trait Door: Send + Sync {
    /// Whether everyone may have this path's content now, from every web page: the answer will
    /// say `public`, and `Access-Control-Allow-Origin: *`.
    fn is_open(&self, path: &str, headers: &HeaderMap) -> bool;

    /// A request was answered.
    fn answered(&self, status: u16, bytes: u64);
}

/// Answers a connection's requests.
#[derive(Clone)]
pub(crate) struct Service {
    app: App,
    router: TowerToHyperService<Router>,
}

impl Service {
    pub(crate) fn new(app: App) -> Service {
        Service {
            router: TowerToHyperService::new(router(app.clone())),
            app,
        }
    }

    fn at_once(&self, request: &Request<Incoming>) -> Option<Response> {
        let door = self.app.door.as_deref();
        if !door.is_none_or(|door| door.is_open(request.uri().path(), request.headers())) {
            return None;
        }
        let response = data::at_once(&self.app, request)?;
        if let Some(door) = door {
            let bytes = axum::body::HttpBody::size_hint(response.body());
            door.answered(response.status().as_u16(), bytes.lower());
        }
        Some(response)
    }
}

impl hyper::service::Service<Request<Incoming>> for Service {
    type Response = Response;
    type Error = Infallible;
    type Future = Either<
        Ready<Result<Response, Infallible>>,
        TowerToHyperServiceFuture<Router, Request<Incoming>>,
    >;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        match self.at_once(&request) {
            Some(response) => Either::Left(ready(Ok(response))),
            None => Either::Right(self.router.call(request)),
        }
    }
}
