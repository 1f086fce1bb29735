//! Single pictures of a record, without the rest of it.

use super::{Header, Node, Place, StoredArray, wide};
use half::f16;
use lumi_core::{EnvMap, Result};
use std::fmt::Display;
use zarrs::array::{
    ArrayBytes, ArrayShardedExt, ArrayShardedReadableExt, ArrayShardedReadableExtCache,
    ArrayToBytesCodecTraits, ChunkShape, CodecChain, CodecOptions, FromArrayBytes,
};
use zarrs::metadata::v3::MetadataV3;
use zarrs::storage::byte_range::ByteRange;

/// A record's arrays, opened; a picture costs reading its own chunk, and once per shard the shard's index.
pub(in crate::store) struct Pictures {
    place: Place,
    radiance: Stored,
    alpha: Stored,
    albedo: Option<Stored>,
}

struct Stored {
    name: &'static str,
    array: StoredArray,
    indices: ArrayShardedReadableExtCache,
    /// What a chunk is encoded by, checksum included. Partial decoding would not look at that, and would take a chunk that
    /// is not there for zeros.
    codecs: CodecChain,
    chunk: ChunkShape,
}

impl Pictures {
    /// Reads what describes a record, and checks that its arrays are as that says.
    pub fn open(place: Place) -> Result<(Header, Self)> {
        let node = Node::new(&place)?;
        let header = node.header()?;
        let (width, height) = header.check().map_err(|e| e.at(place.path()))?;
        let shape = [header.lights.len(), header.cameras.len(), height, width, 3];
        let radiance = Stored::open(&node, "radiance", &shape, 2)?;
        let alpha = Stored::open(&node, "alpha", &shape[1..4], 1)?;
        let albedo = if place.has("albedo/zarr.json")? {
            Some(Stored::open(&node, "albedo", &shape[1..], 1)?)
        } else {
            None
        };
        let pictures = Self {
            radiance,
            alpha,
            albedo,
            place,
        };
        Ok((header, pictures))
    }

    pub fn has_albedo(&self) -> bool {
        self.albedo.is_some()
    }

    pub fn radiance(&self, light: usize, view: usize) -> Result<Vec<f16>> {
        self.radiance.picture(&self.place, &[light, view])
    }

    pub fn alpha(&self, view: usize) -> Result<Vec<f16>> {
        self.alpha.picture(&self.place, &[view])
    }

    /// `None` if the record has none.
    pub fn albedo(&self, view: usize) -> Result<Option<Vec<f16>>> {
        let albedo = self.albedo.as_ref();
        albedo.map(|a| a.picture(&self.place, &[view])).transpose()
    }

    pub fn map(&self, light: &str) -> Result<EnvMap> {
        Node::new(&self.place)?.map(light)
    }
}

impl Stored {
    /// The array `name`, whose pictures are numbered by its first `outer` axes.
    fn open(node: &Node<'_>, name: &'static str, shape: &[usize], outer: usize) -> Result<Self> {
        let array = node.checked(name, shape)?;
        let mut one = wide(shape);
        one[..outer].fill(1);
        let missing = || node.wrong(name, &format!("expected shards of chunks {one:?}"));
        let chunk = array.subchunk_shape().ok_or_else(missing)?;
        if !chunk.iter().map(|side| side.get()).eq(one.iter().copied()) {
            let expected = format!("expected shards of chunks {one:?}, found {chunk:?}");
            return Err(node.wrong(name, &expected));
        }
        let metadata = serde_json::to_value(array.metadata()).map_err(|e| node.wrong(name, &e))?;
        let codecs = metadata.pointer("/codecs/0/configuration/codecs").cloned();
        let codecs: Vec<MetadataV3> =
            serde_json::from_value(codecs.unwrap_or_default()).map_err(|e| node.wrong(name, &e))?;
        Ok(Self {
            name,
            codecs: CodecChain::from_metadata(&codecs).map_err(|e| node.wrong(name, &e))?,
            chunk,
            indices: ArrayShardedReadableExtCache::new(&array),
            array,
        })
    }

    fn picture(&self, place: &Place, at: &[usize]) -> Result<Vec<f16>> {
        let node = Node::new(place)?;
        let wrong = |e: &dyn Display| node.wrong(self.name, e);
        let mut chunk = wide(at);
        chunk.resize(self.array.dimensionality(), 0);
        let sides: Vec<u64> = self.chunk.iter().map(|side| side.get()).collect();
        let (kind, fill) = (self.array.data_type(), self.array.fill_value());
        let values = sides.iter().product::<u64>();
        // The library takes what an index says for granted.
        let range = self.array.subchunk_byte_range(&self.indices, &chunk);
        let bytes = match range.map_err(|e| wrong(&e))? {
            None => return Err(wrong(&format!("expected picture {at:?}, found no shard"))),
            // A picture that is black all over: shards leave out chunks of the fill value, and their index says so with
            // two of the largest numbers, which the library adds up.
            Some(ByteRange::FromStart(u64::MAX, Some(u64::MAX))) => {
                ArrayBytes::new_fill_value(kind, values, fill).map_err(|e| wrong(&e))?
            }
            Some(range) => {
                // Encoding does not make a picture much larger.
                let (length, most) = (range.length(u64::MAX), 4 * values + 1024);
                if length > most {
                    let expected = format!("expected picture {at:?} in at most {most} bytes");
                    return Err(wrong(&format!("{expected}, found {length}")));
                }
                let encoded = self.array.retrieve_encoded_subchunk(&self.indices, &chunk);
                let encoded = encoded.map_err(|e| wrong(&e))?.unwrap_or_default();
                let options = CodecOptions::default();
                self.codecs
                    .decode(encoded.into(), &self.chunk, kind, fill, &options)
                    .map_err(|e| wrong(&e))?
                    .into_owned()
            }
        };
        Vec::from_array_bytes(bytes, &sides, kind).map_err(|e| wrong(&e))
    }
}
