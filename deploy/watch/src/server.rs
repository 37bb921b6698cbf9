//! Routes and answers.
//!
//! ```text
//! /  /run/BELOW                    the page, which is the same for all
//! /asset/NAME                      its script, style and library
//! /state  /state/BELOW             what there is to show, as JSON
//! /events  /events/BELOW           the same whenever it changes, as server-sent events
//! /timeline/FROM  /.../BELOW       the moments of a run from line FROM on
//! /settings  /settings/BELOW       the run's configuration, as text
//! ```

use crate::hosts::is_own;
use crate::pages::{Pages, Shown};
use crate::root::Below;
use axum::Router;
use axum::extract::{Path, Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::spawn_blocking;
use tokio::time::sleep;

/// Pages that are kept up to date at once, at most.
pub(crate) const MAX_STREAMS: usize = 128;
/// Pause between the end of one look and the next; longer than `pages::LOOK_EVERY`, so that each look finds something new.
const EVERY: Duration = Duration::from_secs(1);

const PAGE: &str = include_str!("../page/index.html");
/// Name, type and contents of what the page is made of.
const ASSETS: [(&str, &str, &[u8]); 9] = [
    ("page.js", "text/javascript; charset=utf-8", include_bytes!("../page/page.js")),
    ("dom.js", "text/javascript; charset=utf-8", include_bytes!("../page/dom.js")),
    ("charts.js", "text/javascript; charset=utf-8", include_bytes!("../page/charts.js")),
    ("run.js", "text/javascript; charset=utf-8", include_bytes!("../page/run.js")),
    ("folder.js", "text/javascript; charset=utf-8", include_bytes!("../page/folder.js")),
    ("map.js", "text/javascript; charset=utf-8", include_bytes!("../page/map.js")),
    ("page.css", "text/css; charset=utf-8", include_bytes!("../page/page.css")),
    ("uPlot.js", "text/javascript; charset=utf-8", include_bytes!("../page/uplot/uPlot.min.js")),
    ("uPlot.css", "text/css; charset=utf-8", include_bytes!("../page/uplot/uPlot.min.css")),
];
/// Nothing of another origin, nothing inline, and the page in no frame.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

#[derive(Clone)]
pub(crate) struct App {
    pages: Arc<Pages>,
    streams: Arc<Semaphore>,
    /// The name of this machine, where others may reach the page.
    own: Option<Arc<str>>,
}

/// All routes. `own`: a further name that requests may have for this server.
pub(crate) fn router(pages: Pages, own: Option<String>) -> Router {
    let app = App {
        pages: Arc::new(pages),
        streams: Arc::new(Semaphore::new(MAX_STREAMS)),
        own: own.map(Into::into),
    };
    Router::new()
        .route("/", get(page))
        .route("/run/{*below}", get(page))
        .route("/asset/{name}", get(asset))
        .route("/state", get(state_of_all))
        .route("/state/{*below}", get(state))
        .route("/events", get(events_of_all))
        .route("/events/{*below}", get(events))
        .route("/timeline/{from}", get(timeline_of_all))
        .route("/timeline/{from}/{*below}", get(timeline))
        .route("/settings", get(settings_of_all))
        .route("/settings/{*below}", get(settings))
        .layer(from_fn_with_state(app.clone(), guard))
        .with_state(app)
}

/// Refuses requests that are for another name, and says what browsers may do with the answers.
async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let host = request.headers().get(header::HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    let mut response = match is_own(host, app.own.as_deref()) {
        true => next.run(request).await,
        false => {
            refuse(StatusCode::FORBIDDEN, "this page has another name; accepted: localhost, or an IP address")
        }
    };
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refuse(status: StatusCode, text: &'static str) -> Response {
    (status, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], text).into_response()
}

fn nothing() -> Response {
    refuse(StatusCode::NOT_FOUND, "there is nothing here")
}

fn text(kind: &'static str, body: impl IntoResponse) -> Response {
    ([(header::CONTENT_TYPE, kind)], body).into_response()
}

fn json(body: impl IntoResponse) -> Response {
    text("application/json", body)
}

async fn page() -> Response {
    text("text/html; charset=utf-8", PAGE)
}

async fn asset(Path(name): Path<String>) -> Response {
    let found = ASSETS.iter().find(|(known, ..)| *known == name);
    found.map_or_else(nothing, |(_, kind, contents)| text(kind, *contents))
}

/// What a page shows now. None: reading it has failed in a way that it should not.
async fn look(app: &App, below: &Below) -> Option<Shown> {
    let (pages, below) = (Arc::clone(&app.pages), below.clone());
    spawn_blocking(move || pages.look(&below)).await.ok()
}

async fn shown(app: App, below: Option<Below>) -> Response {
    let Some(below) = below else { return nothing() };
    match look(&app, &below).await {
        Some(shown) => json(shown.json.to_string()),
        None => refuse(StatusCode::INTERNAL_SERVER_ERROR, "the folder cannot be read"),
    }
}

async fn state_of_all(State(app): State<App>) -> Response {
    shown(app, Some(Below::default())).await
}

async fn state(State(app): State<App>, Path(below): Path<String>) -> Response {
    shown(app, Below::parse(&below)).await
}

/// A browser that is sent what changes. What it is too slow for is left out: the next state is only made when there is room
/// for it.
struct Watching {
    app: App,
    below: Below,
    /// Number of the state that was sent last.
    sent: Option<u64>,
    _place: OwnedSemaphorePermit,
}

async fn stream_of(app: App, below: Option<Below>) -> Response {
    let Some(below) = below else { return nothing() };
    let Ok(place) = Arc::clone(&app.streams).try_acquire_owned() else {
        return refuse(StatusCode::SERVICE_UNAVAILABLE, "too many pages are open; close some");
    };
    let watching = Watching { app, below, sent: None, _place: place };
    let states = stream::unfold(watching, |mut watching| async move {
        loop {
            if watching.sent.is_some() {
                sleep(EVERY).await;
            }
            let shown = look(&watching.app, &watching.below).await?;
            if watching.sent != Some(shown.number) {
                watching.sent = Some(shown.number);
                let event = Event::default().id(shown.number.to_string()).data(&*shown.json);
                return Some((Ok::<_, Infallible>(event), watching));
            }
        }
    });
    Sse::new(states).keep_alive(KeepAlive::new().interval(Duration::from_secs(15))).into_response()
}

async fn events_of_all(State(app): State<App>) -> Response {
    stream_of(app, Some(Below::default())).await
}

async fn events(State(app): State<App>, Path(below): Path<String>) -> Response {
    stream_of(app, Below::parse(&below)).await
}

async fn moments(app: App, below: Option<Below>, from: u64) -> Response {
    let Some(below) = below else { return nothing() };
    match spawn_blocking(move || app.pages.timeline(&below, from)).await {
        Ok(Ok(moments)) => json(moments),
        _ => nothing(),
    }
}

async fn timeline_of_all(State(app): State<App>, Path(from): Path<u64>) -> Response {
    moments(app, Some(Below::default()), from).await
}

async fn timeline(State(app): State<App>, Path((from, below)): Path<(u64, String)>) -> Response {
    moments(app, Below::parse(&below), from).await
}

async fn settings_in(app: App, below: Option<Below>) -> Response {
    let Some(below) = below else { return nothing() };
    match spawn_blocking(move || app.pages.settings(&below)).await {
        Ok(Some(settings)) => text("text/plain; charset=utf-8", settings),
        _ => nothing(),
    }
}

async fn settings_of_all(State(app): State<App>) -> Response {
    settings_in(app, Some(Below::default())).await
}

async fn settings(State(app): State<App>, Path(below): Path<String>) -> Response {
    settings_in(app, Below::parse(&below)).await
}
