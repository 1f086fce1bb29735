//! Object stores, where the feature `remote` is built in.

use lumi_core::Result;
use std::path::Path;
use zarrs::storage::ReadableWritableListableStorage;

#[cfg(not(feature = "remote"))]
pub(super) fn open(
    store: &Path,
    _bucket: &str,
    _folder: &str,
) -> Result<ReadableWritableListableStorage> {
    let expected =
        "expected a folder; built without the feature `remote`, which object stores need";
    Err(lumi_core::Error::invalid(store, "store", expected))
}

#[cfg(feature = "remote")]
pub(super) use built_in::open;

#[cfg(feature = "remote")]
mod built_in {
    use super::super::place::wrong;
    use super::{Path, ReadableWritableListableStorage, Result};
    use object_store::aws::AmazonS3Builder;
    use object_store::prefix::PrefixStore;
    use std::collections::BTreeMap;
    use std::future::Future;
    use std::sync::{Arc, Mutex, PoisonError};
    use tokio::runtime::{Builder, Runtime};
    use zarrs::storage::storage_adapter::async_to_sync::{
        AsyncToSyncBlockOn, AsyncToSyncStorageAdapter,
    };
    use zarrs_object_store::AsyncObjectStore;

    /// One client per bucket and folder: connections are kept between records.
    static OPEN: Mutex<BTreeMap<[String; 2], ReadableWritableListableStorage>> =
        Mutex::new(BTreeMap::new());

    /// The store in this folder of a bucket; `store` is for messages. Credentials, region and endpoint come from the
    /// usual environment variables (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT`,
    /// `AWS_ALLOW_HTTP`).
    pub(in crate::store) fn open(
        store: &Path,
        bucket: &str,
        folder: &str,
    ) -> Result<ReadableWritableListableStorage> {
        let mut stores = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        let key = [bucket, folder].map(str::to_owned);
        if let Some(open) = stores.get(&key) {
            return Ok(Arc::clone(open));
        }
        let wrong = |e: &dyn std::fmt::Display| wrong(store, "store", e);
        // An error says that a provider is installed already, which will do.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let client = AmazonS3Builder::from_env().with_bucket_name(bucket).build();
        let client = PrefixStore::new(client.map_err(|e| wrong(&e))?, folder);
        let runtime = Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build();
        let blocking = Blocking(runtime.map_err(|e| wrong(&e))?);
        let client = Arc::new(AsyncObjectStore::new(client));
        let open: ReadableWritableListableStorage =
            Arc::new(AsyncToSyncStorageAdapter::new(client, blocking));
        stores.insert(key, Arc::clone(&open));
        Ok(open)
    }

    struct Blocking(Runtime);

    impl AsyncToSyncBlockOn for Blocking {
        fn block_on<F: Future>(&self, future: F) -> F::Output {
            self.0.block_on(future)
        }
    }
}
