//! A plan from Rust, with Zenoh and JSON alone.
//!
//!     cargo run -- tcp/127.0.0.1:7447
//!
//! What a client in any language does is told in `tools/examples/plain_zenoh.py`; the messages are in
//! `guidefield docs wire`. The project's tests check the form of this file and don't compile it: its crates come from a
//! registry that they can't count on.

use std::time::Duration;

use serde_json::{json, Value};
use zenoh::bytes::Encoding;
use zenoh::{Config, Result, Session};

const PLANNING_TIME: u64 = 60;
/// The query has more time than the plan, so that the service has the last word [s].
const MARGIN: u64 = 90;

/// The one answer to a request; an error where it is one, or where there is none.
async fn ask(session: &Session, key: &str, request: &Value, seconds: u64) -> Result<Value> {
    let answers = session
        .get(key)
        .payload(request.to_string())
        .encoding(Encoding::APPLICATION_JSON)
        .attachment("main.rs")
        .timeout(Duration::from_secs(seconds))
        .await?;
    let answer = answers
        .recv_async()
        .await
        .map_err(|_| "the service is gone")?;
    match answer.result() {
        Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes())?),
        Err(error) => Err(told(&error.payload().to_bytes()).into()),
    }
}

/// What an error says: guidefield's are JSON, Zenoh's own are words.
fn told(payload: &[u8]) -> String {
    match serde_json::from_slice::<Value>(payload) {
        Ok(error) => format!(
            "{} ({}): {}",
            error["name"], error["code"], error["message"]
        ),
        Err(_) => String::from_utf8_lossy(payload).into_owned(),
    }
}

/// A service, found by its liveliness token: the prefix of its keys.
async fn found(session: &Session) -> Result<String> {
    let tokens = session
        .liveliness()
        .get("guidefield/*/alive")
        .timeout(Duration::from_secs(5))
        .await?;
    while let Ok(token) = tokens.recv_async().await {
        if let Ok(sample) = token.result() {
            let key = sample.key_expr().as_str();
            return Ok(key.trim_end_matches("/alive").to_string());
        }
    }
    Err("no service is alive".into())
}

#[tokio::main]
async fn main() -> Result<()> {
    let endpoint = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "tcp/127.0.0.1:7447".to_string());
    let mut config = Config::default();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("connect/endpoints", &json!([endpoint]).to_string())?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    let session = zenoh::open(config).await?;
    let service = found(&session).await?;

    let request = json!({
        "robot": "ur5",
        "scene": "table",
        "goal": {"type": "joints", "positions": {"elbow_joint": 1.2}},
        "guide_planes": [],
        "allowed_planning_time": PLANNING_TIME,
    });
    let key = format!("{service}/plan");
    let reply = ask(&session, &key, &request, PLANNING_TIME + MARGIN).await?;
    println!(
        "{}: {}",
        reply["status"]["name"], reply["status"]["message"]
    );
    if let Some(times) = reply["trajectory"]["times"].as_array() {
        println!("{} knots, {} s long", times.len(), times[times.len() - 1]);
        println!(
            "{} m between {}",
            reply["clearance"]["minimum"], reply["clearance"]["pair"]
        );
    }
    session.close().await
}
