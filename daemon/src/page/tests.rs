use std::{net::SocketAddr, time::Duration};

use futures_util::{SinkExt as _, StreamExt as _};
use posed_signal::HostTime;
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
    sync::oneshot,
    task::JoinHandle,
    time,
};
use tokio_tungstenite::{
    WebSocketStream, client_async,
    tungstenite::{Message, client::IntoClientRequest as _, protocol::CloseFrame},
};

use super::*;
use crate::{
    grpc::{
        Hub, PoseSink,
        services::tests::{Ends, services},
    },
    heights::Avatar,
    pipeline::tracking::Request,
    published::tests::pose_at,
};

const PATIENCE: Duration = Duration::from_secs(20);

/// A page that is served, and the other end of everything it is given.
struct Served {
    addr: SocketAddr,
    sink: PoseSink,
    hub: Hub,
    ends: Ends,
    stop: oneshot::Sender<()>,
    server: JoinHandle<io::Result<()>>,
}

impl Served {
    fn new(access: Access) -> Self {
        let (sink, hub) = Hub::new().unwrap();
        let (services, ends) = services(&hub, None);
        let page = Page {
            services,
            ticks: None,
            playback: None,
            rate_hz: 90.0,
            room: Default::default(),
        };
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let addr = listener.local_addr().unwrap();
        let (stop, stopped) = oneshot::channel();
        let shutdown = async {
            let _ = stopped.await;
        };
        let server = tokio::spawn(serve(page, access, listener, shutdown));
        Self {
            addr,
            sink,
            hub,
            ends,
            stop,
            server,
        }
    }

    /// The whole answer to a request, headers and body.
    async fn http(&self, method: &str, path: &str, headers: &str, body: &str) -> String {
        let mut stream = TcpStream::connect(self.addr).await.unwrap();
        let host = if headers.contains("Host:") {
            String::new()
        } else {
            format!("Host: {}\r\n", self.addr)
        };
        let length = body.len();
        let request = format!(
            "{method} {path} HTTP/1.1\r\n{host}{headers}Content-Length: {length}\r\n\
             Connection: close\r\n\r\n{body}"
        );
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).await.unwrap();
        answer
    }

    async fn get(&self, path: &str) -> String {
        self.http("GET", path, "", "").await
    }

    async fn post(&self, body: &str) -> String {
        self.http(
            "POST",
            "/control",
            "Content-Type: application/json\r\n",
            body,
        )
        .await
    }

    async fn browser(&self, origin: &str) -> Result<Browser, String> {
        let mut request = format!("ws://{}/live", self.addr)
            .into_client_request()
            .unwrap();
        request
            .headers_mut()
            .insert("Origin", origin.parse().unwrap());
        let stream = TcpStream::connect(self.addr).await.unwrap();
        let joined = client_async(request, stream).await;
        joined
            .map(|(browser, _)| Browser(browser))
            .map_err(|error| error.to_string())
    }

    async fn own_browser(&self) -> Result<Browser, String> {
        self.browser(&format!("http://{}", self.addr)).await
    }
}

struct Browser(WebSocketStream<TcpStream>);

impl Browser {
    async fn next(&mut self) -> Message {
        time::timeout(PATIENCE, self.0.next())
            .await
            .unwrap()
            .unwrap()
            .unwrap()
    }

    /// The next message of JSON; poses before it are left out.
    async fn json(&mut self) -> serde_json::Value {
        loop {
            if let Message::Text(text) = self.next().await {
                return serde_json::from_str(text.as_str()).unwrap();
            }
        }
    }

    /// The next pose's sequence number; JSON before it is left out.
    async fn sequence(&mut self) -> u32 {
        loop {
            if let Message::Binary(bytes) = self.next().await {
                return u32::from_le_bytes(bytes[..4].try_into().unwrap());
            }
        }
    }

    async fn grant(&mut self) {
        self.0.send(Message::text("1")).await.unwrap();
    }
}

fn status(answer: &str) -> u16 {
    answer.split(' ').nth(1).unwrap().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_configuration_says_where_and_whether() {
    let page = || {
        let (sink, hub) = Hub::new().unwrap();
        let page = Page {
            services: services(&hub, None).0,
            ticks: None,
            playback: None,
            rate_hz: 90.0,
            room: Default::default(),
        };
        (sink, page)
    };
    let start = |listen: Option<SocketAddr>, page| {
        start(
            &Handle::current(),
            &config::Page {
                listen,
                token: String::new(),
            },
            page,
        )
    };
    assert_eq!(start(None, page().1).unwrap(), None);
    let (sink, served) = page();
    let url = start(Some("127.0.0.1:0".parse().unwrap()), served)
        .unwrap()
        .unwrap();
    let addr: SocketAddr = url["http://".len()..]
        .trim_end_matches('/')
        .parse()
        .unwrap();
    assert!(TcpStream::connect(addr).await.is_ok(), "{url}");
    let taken = start(Some(addr), page().1).unwrap_err().to_string();
    assert!(
        taken.contains(&addr.to_string()) && taken.contains("page.listen"),
        "{taken}"
    );
    let wide = start(Some("0.0.0.0:0".parse().unwrap()), page().1)
        .unwrap_err()
        .to_string();
    assert!(wide.contains("token"), "{wide}");
    drop(sink);
    let gone = async { while TcpStream::connect(addr).await.is_ok() {} };
    time::timeout(PATIENCE, gone).await.unwrap();
}

#[tokio::test]
async fn the_page_is_whole_and_asks_for_nothing_from_outside() {
    let served = Served::new(Access::local());
    let page = served.get("/").await;
    assert_eq!(status(&page), 200);
    assert!(
        page.contains("content-security-policy: default-src 'none'"),
        "{page}"
    );
    let mut waiting = vec![page];
    let mut seen = Vec::new();
    while let Some(text) = waiting.pop() {
        // Only the name of SVG's namespace and the page's own address.
        let text = text
            .replace("http://www.w3.org/2000/svg", "")
            .replace("ws://${location", "");
        assert!(!text.contains("://"), "{text}");
        for name in [
            "page.css",
            "page.js",
            "icon.svg",
            "scene.js",
            "charts.js",
            "shapes.js",
        ] {
            if text.contains(name) && !seen.contains(&name) {
                seen.push(name);
                let file = served.get(&format!("/{name}")).await;
                assert_eq!(status(&file), 200, "{name}");
                assert!(file.contains("x-content-type-options: nosniff"));
                waiting.push(file);
            }
        }
    }
    assert_eq!(seen.len(), 6, "{seen:?}");
    assert_eq!(status(&served.get("/../Cargo.toml").await), 404);
}

#[tokio::test]
async fn buttons_reach_the_tracker_and_nonsense_does_not() {
    let mut served = Served::new(Access::local());
    assert_eq!(status(&served.post("{\"height_m\": 5}").await), 400);
    assert_eq!(
        status(&served.post(&" ".repeat(BODY_BYTES_MAX + 1)).await),
        413
    );
    let form = served
        .http(
            "POST",
            "/control",
            "Content-Type: text/plain\r\n",
            "\"reset\"",
        )
        .await;
    assert_eq!(status(&form), 415);
    assert_eq!(status(&served.get("/control").await), 405);
    assert_eq!(served.ends.requests.pop(), None);
    assert_eq!(status(&served.post("\"reset\"").await), 204);
    assert_eq!(status(&served.post("{\"height_m\": 1.6}").await), 204);
    assert_eq!(
        status(&served.post("\"reset\"").await),
        503,
        "two are waiting"
    );
    assert_eq!(served.ends.requests.pop(), Some(Request::Reset));
    let height = Request::Height {
        metres: 1.6,
        avatar: Avatar::Keep,
    };
    assert_eq!(served.ends.requests.pop(), Some(height));
}

#[tokio::test]
async fn other_sites_and_other_names_are_kept_out() {
    let mut served = Served::new(Access::local());
    let json = "Content-Type: application/json\r\n";
    for header in [
        "Origin: http://evil.example\r\n",
        "Host: evil.example\r\n",
        "Origin: null\r\n",
    ] {
        let answer = served
            .http("POST", "/control", &format!("{header}{json}"), "\"reset\"")
            .await;
        assert_eq!(status(&answer), 403, "{header}");
        assert_eq!(
            status(&served.http("GET", "/", header, "").await),
            403,
            "{header}"
        );
    }
    assert_eq!(served.ends.requests.pop(), None);
    assert!(
        served
            .browser("http://evil.example")
            .await
            .is_err_and(|error| error.contains("403"))
    );
    assert!(served.own_browser().await.is_ok());
}

#[tokio::test]
async fn from_elsewhere_only_with_the_token() {
    let served = Served::new(Access::with_token("a-long-enough-token").unwrap());
    for path in ["/", "/page.js", "/?token=wrong"] {
        assert_eq!(status(&served.get(path).await), 401, "{path}");
    }
    let welcome = served.get("/?token=a-long-enough-token").await;
    assert_eq!(status(&welcome), 303);
    let cookie = welcome
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "))
        .unwrap();
    let cookie = format!("Cookie: {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(status(&served.http("GET", "/", &cookie, "").await), 200);
    assert!(
        served
            .own_browser()
            .await
            .is_err_and(|error| error.contains("401"))
    );
}

#[tokio::test]
async fn a_browser_gets_the_newest_pose_for_each_credit_and_none_without() {
    let mut served = Served::new(Access::local());
    let mut browser = served.own_browser().await.unwrap();
    let hello = browser.json().await;
    assert_eq!(hello["hello"]["trackers"], serde_json::json!(["ik", "pip"]));
    assert_eq!(hello["hello"]["parents"].as_array().map(Vec::len), Some(22));
    assert_eq!(browser.json().await["status"]["height_m"], 1.8f32);
    for sequence in 1..=5 {
        served
            .sink
            .publish(&pose_at(sequence, HostTime(sequence * 1000)));
    }
    while served.hub.latest().map(|pose| pose.sequence) != Some(5) {
        tokio::task::yield_now().await;
    }
    browser.grant().await;
    assert_eq!(browser.sequence().await, 5, "the newest");
    served.sink.publish(&pose_at(6, HostTime(6000)));
    served.sink.publish(&pose_at(7, HostTime(7000)));
    // Without a credit only the status comes.
    for _ in 0..2 {
        assert!(matches!(browser.next().await, Message::Text(_)));
    }
    browser.grant().await;
    assert_eq!(browser.sequence().await, 7);
    browser.grant().await;
    served.sink.publish(&pose_at(8, HostTime(8000)));
    assert_eq!(
        browser.sequence().await,
        8,
        "a credit waits for the next pose"
    );
}

#[tokio::test]
async fn so_many_may_watch_and_all_are_sent_off_at_the_end() {
    let served = Served::new(Access::local());
    let mut browsers = Vec::new();
    for _ in 0..WATCHERS_MAX {
        browsers.push(served.own_browser().await.unwrap());
    }
    assert!(
        served
            .own_browser()
            .await
            .is_err_and(|error| error.contains("503"))
    );
    browsers.pop();
    while served.own_browser().await.is_err() {
        tokio::task::yield_now().await;
    }
    served.stop.send(()).unwrap();
    for browser in &mut browsers {
        loop {
            if let Message::Close(frame) = browser.next().await {
                let reason = frame.map(|CloseFrame { reason, .. }| reason.to_string());
                assert_eq!(reason.as_deref(), Some("posed is stopping"));
                break;
            }
        }
    }
    drop(browsers);
    time::timeout(PATIENCE, served.server)
        .await
        .unwrap()
        .unwrap()
        .unwrap();
}
