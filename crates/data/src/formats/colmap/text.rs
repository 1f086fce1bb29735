//! `cameras.txt` and `images.txt`.

use super::{CameraModel, Model, ModelCamera, ModelImage};
use lumi_core::fs::read_bytes;
use lumi_core::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

pub(super) fn read(cameras: &Path, images: &Path) -> Result<Model> {
    Ok(Model {
        cameras: parse_cameras(cameras, &text(cameras)?)?,
        images: parse_images(images, &text(images)?)?,
    })
}

fn text(path: &Path) -> Result<String> {
    let wrong = |_| Error::invalid(path, "text", "expected UTF-8");
    let text = String::from_utf8(read_bytes(path)?).map_err(wrong)?;
    // Editors of Windows write a byte order mark.
    Ok(text
        .strip_prefix('\u{feff}')
        .map(str::to_owned)
        .unwrap_or(text))
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS…` a line.
pub(crate) fn parse_cameras(path: &Path, text: &str) -> Result<BTreeMap<u32, ModelCamera>> {
    let mut cameras = BTreeMap::new();
    for (number, line) in lines(text) {
        if line.trim().is_empty() {
            continue;
        }
        let at = |e: Error| e.within(format!("line {number}")).at(path);
        let mut words = line.split_whitespace();
        let id: u32 = next(&mut words, "camera id").map_err(at)?;
        let model: String = next(&mut words, "model").map_err(at)?;
        let camera = ModelCamera {
            model: CameraModel::by_name(&model).map_err(at)?,
            width: next(&mut words, "width").map_err(at)?,
            height: next(&mut words, "height").map_err(at)?,
            params: words
                .map(|w| parse(w, "parameter"))
                .collect::<Result<_>>()
                .map_err(at)?,
        };
        if cameras.insert(id, camera).is_some() {
            return Err(at(Error::value("camera id", "expected ids that differ")));
        }
    }
    Ok(cameras)
}

/// Two lines an image: `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, then its points, which may be none. Programs
/// that write no points may leave out their line as well: a line after an image that is one itself is the next image.
pub(crate) fn parse_images(path: &Path, text: &str) -> Result<Vec<ModelImage>> {
    let mut images = Vec::new();
    let mut lines = lines(text).peekable();
    while let Some((number, line)) = lines.next() {
        // Only the line of points may be empty; blank lines at the end belong to no image.
        if line.trim().is_empty() {
            continue;
        }
        let at = |e: Error| e.within(format!("line {number}")).at(path);
        images.push(image(line).map_err(at)?);
        let _points = lines.next_if(|(_, line)| !is_image(line));
    }
    Ok(images)
}

/// Whether a line is an image's and not one of points, which are numbers all along.
fn is_image(line: &str) -> bool {
    let number = |word: &&str| word.parse::<f64>().is_ok();
    let words: Vec<&str> = line.split_whitespace().collect();
    words.len() > 9 && words[..9].iter().all(number) && !words[9..].iter().all(number)
}

fn image(line: &str) -> Result<ModelImage> {
    // A name may hold spaces, so only the nine words before it are split off.
    let mut rest = line.trim();
    let mut words = [""; 9];
    for word in &mut words {
        let (first, after) = rest
            .split_once(char::is_whitespace)
            .ok_or_else(|| Error::value("image", "expected 9 numbers and a name"))?;
        (*word, rest) = (first, after.trim_start());
    }
    let number = |i: usize| parse::<f64>(words[i], "pose");
    Ok(ModelImage {
        rotation: [number(1)?, number(2)?, number(3)?, number(4)?],
        translation: [number(5)?, number(6)?, number(7)?],
        camera: parse(words[8], "camera id")?,
        name: rest.to_owned(),
    })
}

/// Lines with their numbers, comments left out.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let numbered = text.lines().enumerate().map(|(i, line)| (i + 1, line));
    numbered.filter(|(_, line)| !line.starts_with('#'))
}

fn next<'a, T: FromStr>(words: &mut impl Iterator<Item = &'a str>, field: &str) -> Result<T> {
    let word = words.next();
    let word = word.ok_or_else(|| Error::value(field, "expected one more word in the line"))?;
    parse(word, field)
}

fn parse<T: FromStr>(word: &str, field: &str) -> Result<T> {
    let wrong = |_| Error::value(field, format!("expected a number, found `{word}`"));
    word.parse().map_err(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_without_points_and_names_with_spaces() {
        let text = "# two lines of data\n1 1 0 0 0 1 2 3 7 a b.jpg\n\n2 0 1 0 0 4 5 6 7 c.jpg\n1.0 2.0 -1\n\n";
        let images = parse_images(Path::new("images.txt"), text).expect("reads");
        assert_eq!((images.len(), images[0].name.as_str()), (2, "a b.jpg"));
        assert_eq!(images[1].translation, [4.0, 5.0, 6.0]);
        let message = parse_images(Path::new("images.txt"), "1 1 0 0 0 1 2")
            .expect_err("cut")
            .to_string();
        assert!(message.contains("images.txt: line 1"), "{message}");
    }

    #[test]
    fn missing_lines_of_points_are_recognised() {
        let line = |i: usize| format!("{i} 1 0 0 0 {i} 0 0 7 {i}.png\n");
        let points = "1.5 2.5 -1 3 4 7 1 2 3 4 5 6\n";
        let all = |text: &str| -> Vec<String> {
            let images = parse_images(Path::new("images.txt"), text).expect("reads");
            images.into_iter().map(|i| i.name).collect()
        };
        let expected = ["1.png", "2.png", "3.png"];
        assert_eq!(all(&[1, 2, 3].map(line).concat()), expected);
        assert_eq!(all(&[1, 2, 3].map(|i| line(i) + points).concat()), expected);
        assert_eq!(all(&[1, 2, 3].map(|i| line(i) + "\n").concat()), expected);
        assert_eq!(
            all(&[line(1), line(2), points.into(), line(3)].concat()),
            expected
        );
    }

    #[test]
    fn cameras_are_checked() {
        let path = Path::new("cameras.txt");
        let cameras = parse_cameras(path, "1 OPENCV 640 480 500 501 320 240 .1 0 0 0\n");
        assert_eq!(cameras.expect("reads")[&1].params[4], 0.1);
        for (text, part) in [
            ("1 FOV 1 1 1 1 1 1 1", "FOV"),
            ("x PINHOLE 1 1 1 1 1 1", "line 1: camera id"),
            ("1 PINHOLE 1", "height"),
            ("1 PINHOLE 1 1 1 1 1 z", "parameter"),
        ] {
            let message = parse_cameras(path, text).expect_err(text).to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
