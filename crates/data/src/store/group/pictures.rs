//! Single pictures of a record, without the rest of it.

use super::{Header, Node, Place, StoredArray, wide};
use half::f16;
use lumi_core::{EnvMap, Result};

use zarrs::array::{
    ArrayShardedExt, ArrayShardedReadableExt, ArrayShardedReadableExtCache,
    ArrayToBytesCodecTraits, ChunkShape, CodecChain, CodecOptions, FromArrayBytes,
};
use zarrs::metadata::v3::MetadataV3;

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
        let mut chunk = wide(at);
        chunk.resize(self.array.dimensionality(), 0);
        let encoded = self.array.retrieve_encoded_subchunk(&self.indices, &chunk);
        let encoded = encoded.map_err(|e| node.wrong(self.name, &e))?;
        let Some(encoded) = encoded else {
            return Err(node.wrong(self.name, &format!("expected picture {at:?}, found none")));
        };
        let (kind, fill) = (self.array.data_type(), self.array.fill_value());
        let options = CodecOptions::default();
        let decoded = self
            .codecs
            .decode(encoded.into(), &self.chunk, kind, fill, &options);
        let decoded = decoded.map_err(|e| node.wrong(self.name, &e))?;
        let side: Vec<u64> = self.chunk.iter().map(|side| side.get()).collect();
        let picture = Vec::from_array_bytes(decoded.into_owned(), &side, kind);
        picture.map_err(|e| node.wrong(self.name, &e))
    }
}
