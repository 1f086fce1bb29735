//! The page's files, embedded.

use crate::{Error, Result};

/// Name, media type and content of each file.
const FILES: &[(&str, &str, &[u8])] = &[
    (
        "index.html",
        "text/html; charset=utf-8",
        include_bytes!("../web/index.html"),
    ),
    (
        "style.css",
        "text/css; charset=utf-8",
        include_bytes!("../web/style.css"),
    ),
    (
        "icon.svg",
        "image/svg+xml",
        include_bytes!("../web/icon.svg"),
    ),
    ("main.js", JS, include_bytes!("../web/main.js")),
    ("api.js", JS, include_bytes!("../web/api.js")),
    ("space.js", JS, include_bytes!("../web/space.js")),
    ("stage.js", JS, include_bytes!("../web/stage.js")),
    ("turntable.js", JS, include_bytes!("../web/turntable.js")),
    ("backdrop.js", JS, include_bytes!("../web/backdrop.js")),
    ("picture.js", JS, include_bytes!("../web/picture.js")),
    ("gizmo.js", JS, include_bytes!("../web/gizmo.js")),
    ("kinds.js", JS, include_bytes!("../web/kinds.js")),
    ("lights.js", JS, include_bytes!("../web/lights.js")),
    ("history.js", JS, include_bytes!("../web/history.js")),
    ("look.js", JS, include_bytes!("../web/look.js")),
    ("dom.js", JS, include_bytes!("../web/dom.js")),
    ("numbers.js", JS, include_bytes!("../web/numbers.js")),
    ("shining.js", JS, include_bytes!("../web/shining.js")),
    ("keys.js", JS, include_bytes!("../web/keys.js")),
    ("photograph.js", JS, include_bytes!("../web/photograph.js")),
    ("dialogs.js", JS, include_bytes!("../web/dialogs.js")),
];

const JS: &str = "text/javascript; charset=utf-8";

/// Media type and content of a file.
///
/// # Errors
/// If the page has no such file.
pub fn file(name: &str) -> Result<(&'static str, &'static [u8])> {
    let found = FILES.iter().find(|(n, ..)| *n == name);
    let missing = || Error::NotFound(format!("`{name}`: the page has no such file"));
    found.map(|f| (f.1, f.2)).ok_or_else(missing)
}
