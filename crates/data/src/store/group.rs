//! A record as a group of a Zarr v3 hierarchy.
//!
//! ```text
//! STORE/zarr.json                 a group, so that any Zarr reader can walk the store
//! STORE/NAME/zarr.json            the record's group; attribute `lumi` holds cameras and lights. Written last
//! STORE/NAME/radiance             [light, view, y, x, 3]  f16, premultiplied by alpha
//! STORE/NAME/alpha                [view, y, x]            f16
//! STORE/NAME/albedo               [view, y, x, 3]         f16, premultiplied by alpha, where it was rendered
//! STORE/NAME/environment/LIGHT    [y, x, 3]               f16, one map per environment light
//! ```
//!
//! Arrays are sharded: a chunk is one picture, compressed by zstd and closed by its CRC-32C, and a shard is as
//! many pictures as fit into [`SHARD`] values. Reading checks every checksum. From Python:
//! `zarr.open_group("STORE", mode="r")["NAME/radiance"][0, 3]`.

mod pictures;

pub(super) use pictures::Pictures;

use super::header::{self, Header};
use super::place::Place;
use super::{ENVIRONMENT_ROWS, ObjectRecord};
use half::f16;
use lumi_core::{EnvMap, Error, Light, Result};
use std::fmt::Display;
use std::sync::Arc;
use zarrs::array::codec::bytes_to_bytes::{crc32c::Crc32cCodec, zstd::ZstdCodec};
use zarrs::array::{Array, ArrayBuilder, CodecOptions, data_type};
use zarrs::group::{Group, GroupBuilder};

/// Key of the header among a group's attributes.
const HEADER_KEY: &str = "lumi";

/// Most values in a shard that we write: 64 MiB before compression. A larger picture is a shard of its own.
const SHARD: usize = 32 << 20;

/// Most values in a shard that we read; a picture of [`lumi_core::image::MAX_PIXELS`] fits.
const LARGEST_SHARD: u64 = 512 << 20;

/// zstd's own default level; renders shrink little more at higher ones.
const LEVEL: i32 = 3;

/// Writes a valid record. An older one of the same name stops counting first, and the group's own
/// metadata come last, so that what has them is complete.
pub(super) fn write(record: &ObjectRecord, place: &Place) -> Result<()> {
    let node = Node::new(place)?;
    let (width, height) = record.size();
    let (lights, views) = (record.lights.len(), record.cameras.len());
    place.erase()?;
    node.write(
        "radiance",
        &[lights, views, height, width, 3],
        &record.radiance,
    )?;
    node.write("alpha", &[views, height, width], &record.alpha)?;
    if let Some(albedo) = &record.albedo {
        node.write("albedo", &[views, height, width, 3], albedo)?;
    }
    let maps = record.lights.iter().filter_map(|l| match &l.light {
        Light::Environment(e) => Some((&l.name, &e.map)),
        _ => None,
    });
    for (i, (name, map)) in maps.enumerate() {
        plain(name).map_err(|e| e.at(place.path()))?;
        if i == 0 {
            node.group("/environment", None)?;
        }
        let map = map.at_most(ENVIRONMENT_ROWS);
        let array = format!("environment/{name}");
        node.write(&array, &[map.height, map.width, 3], &header::halves(&map))?;
    }
    let header = serde_json::to_value(Header::new(record));
    node.root()?;
    node.group("", Some(header.map_err(|e| node.wrong(HEADER_KEY, &e))?))
}

/// Reads a record, which is not validated yet.
pub(super) fn read(place: &Place) -> Result<ObjectRecord> {
    let node = Node::new(place)?;
    let header = node.header()?;
    let (width, height) = header.check().map_err(|e| e.at(place.path()))?;
    let shape = [header.lights.len(), header.cameras.len(), height, width, 3];
    let radiance = node.read("radiance", &shape)?;
    let alpha = node.read("alpha", &shape[1..4])?;
    let albedo = if place.has("albedo/zarr.json")? {
        Some(node.read("albedo", &shape[1..])?)
    } else {
        None
    };
    let mut lights = Vec::with_capacity(header.lights.len());
    for light in header.lights {
        lights.push(light.with_map(|name| node.map(name))?);
    }
    Ok(ObjectRecord {
        name: header.name,
        cameras: header.cameras,
        lights,
        radiance,
        alpha,
        albedo,
    })
}

/// Names of lights and records become parts of keys.
pub(super) fn plain(name: &str) -> Result<()> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "-_+.".contains(c);
    if !name.is_empty() && !name.starts_with(['.', '_']) && name.chars().all(allowed) {
        return Ok(());
    }
    let expected = "expected letters, digits, - _ + . only, beginning with none of . _";
    Err(Error::value(format!("name `{name}`"), expected))
}

/// The record's group.
struct Node<'a> {
    place: &'a Place,
    /// `/NAME`.
    path: String,
}

impl<'a> Node<'a> {
    fn new(place: &'a Place) -> Result<Self> {
        plain(place.name()).map_err(|e| e.at(place.path()))?;
        let path = format!("/{}", place.name());
        Ok(Self { place, path })
    }

    fn wrong(&self, field: &str, e: &dyn Display) -> Error {
        self.place.wrong(field, e)
    }

    /// What describes the record.
    fn header(&self) -> Result<Header> {
        let group = Group::open(Arc::clone(self.place.storage()), &self.path);
        let group = group.map_err(|e| self.wrong("zarr.json", &e))?;
        let header = group.attributes().get(HEADER_KEY).cloned();
        let header =
            header.ok_or_else(|| self.wrong(HEADER_KEY, &"expected this attribute, found none"))?;
        serde_json::from_value(header).map_err(|e| self.wrong(HEADER_KEY, &e))
    }

    /// Writes metadata of the group at `below` this one.
    fn group(&self, below: &str, header: Option<serde_json::Value>) -> Result<()> {
        let path = format!("{}{below}", self.path);
        let mut group = GroupBuilder::new();
        if let Some(header) = header {
            group.attributes([(HEADER_KEY.to_owned(), header)].into_iter().collect());
        }
        let group = group.build(Arc::clone(self.place.storage()), &path);
        let group = group.map_err(|e| self.wrong("zarr.json", &e))?;
        let text = serde_json::to_vec_pretty(group.metadata());
        let text = text.map_err(|e| self.wrong("zarr.json", &e))?;
        self.place.put(&format!("{}/zarr.json", &path[1..]), &text)
    }

    /// Makes the store a group, once.
    fn root(&self) -> Result<()> {
        const ROOT: &[u8] = b"{\n  \"zarr_format\": 3,\n  \"node_type\": \"group\"\n}\n";
        if self.place.store_has("zarr.json")? {
            return Ok(());
        }
        self.place.put("zarr.json", ROOT)
    }

    fn write(&self, name: &str, shape: &[usize], values: &[f16]) -> Result<()> {
        let wrong = |e: &dyn Display| self.wrong(name, e);
        // Alpha's picture is [y, x], radiance's and albedo's [y, x, 3].
        let inner = if shape.last() == Some(&3) { 3 } else { 2 };
        let outer = shape.len() - inner;
        let mut chunk = vec![1; shape.len()];
        chunk[outer..].copy_from_slice(&shape[outer..]);
        let mut shard = shape.to_vec();
        if outer > 0 {
            let one: usize = shape[1..].iter().product();
            shard[0] = (SHARD / one.max(1)).clamp(1, shape[0]);
        }
        let array = ArrayBuilder::new(wide(shape), wide(&shard), data_type::float16(), f16::ZERO)
            .subchunk_shape(wide(&chunk))
            .bytes_to_bytes_codecs(vec![
                Arc::new(ZstdCodec::new(LEVEL, false)),
                Arc::new(Crc32cCodec::new()),
            ])
            .dimension_names(Some(names(shape.len(), inner)))
            .build(
                Arc::clone(self.place.storage()),
                &format!("{}/{name}", self.path),
            )
            .map_err(|e| wrong(&e))?;
        // A shard of black pictures is data too; a missing one is damage. Threads would put the pictures into their shard in
        // the order in which they happen to finish, and the same record must be the same bytes.
        let options = CodecOptions::default()
            .with_store_empty_chunks(true)
            .with_concurrent_target(1);
        let length: usize = shard.iter().product();
        let mut at = vec![0_u64; shape.len()];
        for part in values.chunks(length) {
            let mut part = part.to_vec();
            part.resize(length, f16::ZERO);
            let stored = array.store_chunk_opt(&at, part, &options);
            stored.map_err(|e| wrong(&e))?;
            at[0] += 1;
        }
        array.store_metadata().map_err(|e| wrong(&e))
    }

    /// The values of an array that must have this shape.
    fn read(&self, name: &str, shape: &[usize]) -> Result<Vec<f16>> {
        self.values(name, &self.checked(name, shape)?)
    }

    /// The array `name`, which must have this shape.
    fn checked(&self, name: &str, shape: &[usize]) -> Result<StoredArray> {
        let array = self.open(name)?;
        if array.data_type() != &data_type::float16() || array.shape() != wide(shape) {
            let expected = format!(
                "expected float16 {shape:?}, found {:?} {:?}",
                array.data_type(),
                array.shape()
            );
            return Err(self.wrong(name, &expected));
        }
        Ok(array)
    }

    fn map(&self, light: &str) -> Result<EnvMap> {
        plain(light).map_err(|e| e.at(self.place.path()))?;
        let name = format!("environment/{light}");
        let array = self.open(&name)?;
        let &[height, width, 3] = array.shape() else {
            let expected = format!("expected [rows, columns, 3], found {:?}", array.shape());
            return Err(self.wrong(&name, &expected));
        };
        let values = self.read(&name, &[height as usize, width as usize, 3])?;
        Ok(header::map(height as usize, width as usize, &values))
    }

    fn open(&self, name: &str) -> Result<StoredArray> {
        let path = format!("{}/{name}", self.path);
        Array::open(Arc::clone(self.place.storage()), &path).map_err(|e| self.wrong(name, &e))
    }

    /// Shard after shard: memory grows only with what is really there.
    fn values(&self, name: &str, array: &StoredArray) -> Result<Vec<f16>> {
        let wrong = |e: &dyn Display| self.wrong(name, e);
        let (shape, grid) = (array.shape(), array.chunk_grid_shape());
        let mut at = vec![0_u64; shape.len()];
        let shard = array.chunk_shape(&at).map_err(|e| wrong(&e))?;
        let length = product(shard.iter().map(|side| side.get()));
        let whole = product(shape.iter().copied());
        let splits_first_axis = grid.iter().skip(1).all(|n| *n == 1);
        let covers = shard
            .iter()
            .skip(1)
            .zip(&shape[1..])
            .all(|(s, n)| s.get() == *n);
        let (Some(length), Some(whole)) = (length.filter(|n| *n <= LARGEST_SHARD), whole) else {
            return Err(wrong(&format!(
                "expected shards of at most {LARGEST_SHARD} values"
            )));
        };
        if !(splits_first_axis && covers) {
            return Err(wrong(&"expected shards that split the first axis only"));
        }
        let mut values = Vec::new();
        for i in 0..whole.div_ceil(length) {
            at[0] = i;
            let part: Option<Vec<f16>> =
                array.retrieve_chunk_if_exists(&at).map_err(|e| wrong(&e))?;
            let part = part.ok_or_else(|| wrong(&format!("expected shard {i}, found none")))?;
            let left = whole - i * length;
            values.extend(
                part.into_iter()
                    .take(usize::try_from(left).unwrap_or(usize::MAX)),
            );
        }
        Ok(values)
    }
}

/// `None` if it does not fit.
fn product(mut sides: impl Iterator<Item = u64>) -> Option<u64> {
    sides.try_fold(1_u64, u64::checked_mul)
}

type StoredArray = Array<dyn zarrs::storage::ReadableWritableListableStorageTraits>;

fn wide(shape: &[usize]) -> Vec<u64> {
    shape.iter().map(|&n| n as u64).collect()
}

/// Names of the axes, for people.
fn names(axes: usize, inner: usize) -> Vec<&'static str> {
    let all: &[&str] = if inner == 3 {
        &["light", "view", "y", "x", "channel"]
    } else {
        &["view", "y", "x"]
    };
    all[all.len() - axes..].to_vec()
}
