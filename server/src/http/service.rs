//! From a connection's requests to their answers: what is at hand is answered on the spot, all
//! else by the router.

use super::{App, data, router};
use crate::metrics::Counted;
use axum::Router;
use axum::body::HttpBody;
use axum::http::{Request, StatusCode, header};
use axum::response::Response;
use futures_util::FutureExt;
use futures_util::future::{Either, Map};
use hyper::body::Incoming;
use hyper_util::service::{TowerToHyperService, TowerToHyperServiceFuture};
use std::convert::Infallible;
use std::future::{Ready, ready};
use std::sync::Arc;
use std::time::Instant;

/// What is answered on the spot has no route of the router's; so it is counted.
const AT_ONCE: &str = "at once";

/// Answers a connection's requests.
#[derive(Clone)]
pub(crate) struct Service {
    /// What can be answered on the spot, and where that is counted.
    spot: Option<(App, Arc<Counted>)>,
    router: TowerToHyperService<Router>,
}

impl Service {
    pub(crate) fn new(app: App) -> Service {
        Service {
            router: TowerToHyperService::new(router(app.clone())),
            spot: Some({
                let counted = app.gate.metrics.counted(AT_ONCE);
                (app, counted)
            }),
        }
    }

    /// All of it by a router.
    pub(crate) fn of(router: Router) -> Service {
        Service {
            spot: None,
            router: TowerToHyperService::new(router),
        }
    }

    fn at_once(&self, request: &Request<Incoming>) -> Option<Response> {
        let (app, counted) = self.spot.as_ref()?;
        let began = Instant::now();
        if !app.gate.lets_pass(request) {
            return None;
        }
        let response = data::at_once(app, request).filter(|_| app.gate.counts(request))?;
        let bytes = response.body().size_hint().lower();
        let status = response.status().as_u16();
        counted.answered(status, bytes, began.elapsed());
        Some(response)
    }
}

type Answer = Result<Response, Infallible>;
type Routed = TowerToHyperServiceFuture<Router, Request<Incoming>>;

/// The router tells HEAD the length of the body, which 304 has not: with it, the length would have
/// to be that of the content (RFC 9110, section 8.6).
fn mended(answer: Answer) -> Answer {
    answer.map(|mut response| {
        if response.status() == StatusCode::NOT_MODIFIED {
            response.headers_mut().remove(header::CONTENT_LENGTH);
        }
        response
    })
}

impl hyper::service::Service<Request<Incoming>> for Service {
    type Response = Response;
    type Error = Infallible;
    type Future = Either<Ready<Answer>, Map<Routed, fn(Answer) -> Answer>>;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        match self.at_once(&request) {
            Some(response) => Either::Left(ready(Ok(response))),
            None => Either::Right(
                self.router
                    .call(request)
                    .map(mended as fn(Answer) -> Answer),
            ),
        }
    }
}
