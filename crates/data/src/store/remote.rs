//! Object stores, where the feature `remote` is built in.

use lumi_core::{Error, Result};
use std::path::Path;
use zarrs::storage::ReadableWritableListableStorage;

#[cfg(not(feature = "remote"))]
pub(super) fn open(store: &Path, url: &str) -> Result<ReadableWritableListableStorage> {
    let expected = format!("expected a folder, found `{url}`; build with the feature `remote`");
    Err(Error::invalid(store, "store", expected))
}

#[cfg(feature = "remote")]
pub(super) use built_in::open;

#[cfg(feature = "remote")]
mod built_in {
    use super::{Error, Path, ReadableWritableListableStorage, Result};
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

    /// One client per URL: connections are kept between records.
    static OPEN: Mutex<BTreeMap<String, ReadableWritableListableStorage>> =
        Mutex::new(BTreeMap::new());

    /// The store at `s3://BUCKET/FOLDER`. Credentials, region and endpoint come from the usual environment
    /// variables (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT`, `AWS_ALLOW_HTTP`).
    pub(in crate::store) fn open(
        store: &Path,
        url: &str,
    ) -> Result<ReadableWritableListableStorage> {
        let mut stores = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(open) = stores.get(url) {
            return Ok(Arc::clone(open));
        }
        let wrong = |e: &dyn std::fmt::Display| Error::invalid(store, "store", e.to_string());
        // An error says that a provider is installed already, which will do.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let (_, rest) = url.split_once("://").unwrap_or_default();
        let (bucket, folder) = rest.split_once('/').unwrap_or((rest, ""));
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
        stores.insert(url.to_owned(), Arc::clone(&open));
        Ok(open)
    }

    struct Blocking(Runtime);

    impl AsyncToSyncBlockOn for Blocking {
        fn block_on<F: Future>(&self, future: F) -> F::Output {
            self.0.block_on(future)
        }
    }
}
