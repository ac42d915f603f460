//! A server in this process, on a port that the system chooses.

use escarp_client::app::headless::Driver;
use escarp_client::net::Url;
use escarp_client::remote::RemoteTerrain;
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_server::source::{GenerationId, Pack, Revised};
use escarp_server::{Catalog, Limits, PageSource, SourceError, serve};
use escarp_tiles::dataset::Dataset;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

/// A wait that takes longer has failed.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// Memory for pages that a test's client takes, bytes.
pub const MEMORY: usize = 256 << 20;

/// A server. Dropping it is a crash: connections end without a word.
pub struct Host {
    address: SocketAddr,
    runtime: Option<Runtime>,
    stop: Option<oneshot::Sender<()>>,
    served: Option<JoinHandle<std::io::Result<()>>>,
}

impl Host {
    /// Hosts sources by name.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(sources: &[(&str, Arc<dyn PageSource>)]) -> Host {
        Host::start_on(0, sources)
    }

    /// Hosts one dataset.
    pub fn of(name: &str, dataset: Dataset) -> Host {
        Host::start(&[(name, Arc::new(dataset))])
    }

    /// As [`start`](Self::start), on a port that another host has left.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start_on(port: u16, sources: &[(&str, Arc<dyn PageSource>)]) -> Host {
        Host::start_with(port, sources, Limits::default())
    }

    /// As [`start_on`](Self::start_on), with these limits.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start_with(port: u16, sources: &[(&str, Arc<dyn PageSource>)], limits: Limits) -> Host {
        let catalog = Catalog::default();
        for (name, source) in sources {
            catalog.add(name, source.clone()).expect("a name");
        }
        Host::of_catalog(port, Arc::new(catalog), limits)
    }

    /// Hosts a catalog, which may change meanwhile; on a free port if it is 0.
    ///
    /// # Panics
    /// If it does not start.
    pub fn of_catalog(port: u16, catalog: Arc<Catalog>, limits: Limits) -> Host {
        let runtime = Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build();
        let runtime = runtime.expect("a runtime");
        let listener = runtime.block_on(TcpListener::bind(("127.0.0.1", port)));
        let listener = listener.unwrap_or_else(|error| panic!("port {port} is not free: {error}"));
        let address = listener.local_addr().expect("an address");
        let (stop, stopped) = oneshot::channel();
        let served = runtime.spawn(serve(listener, catalog, limits, async {
            let _ = stopped.await;
        }));
        Host {
            address,
            runtime: Some(runtime),
            stop: Some(stop),
            served: Some(served),
        }
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The address of a dataset.
    ///
    /// # Panics
    /// If the name cannot stand in an address.
    pub fn url(&self, name: &str) -> Url {
        format!("http://{}/{name}", self.address)
            .parse()
            .expect("an address")
    }

    /// A client of a dataset.
    pub fn client(&self, name: &str) -> Driver {
        Driver::new(RemoteTerrain::open(self.url(name), MEMORY))
    }

    /// Ends it as a signal does: clients are told.
    ///
    /// # Panics
    /// If it does not end.
    pub fn stop(mut self) {
        drop(self.stop.take());
        if let (Some(runtime), Some(served)) = (&self.runtime, self.served.take()) {
            let ended = runtime.block_on(async { tokio::time::timeout(PATIENCE, served).await });
            ended
                .expect("the server ends")
                .expect("without panic")
                .expect("in order");
        }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(10));
        }
    }
}

/// A dataset that notes what is asked of it, and takes its time.
pub struct Watched {
    dataset: Dataset,
    delay: Duration,
    asked: Mutex<Vec<PageId>>,
}

impl Watched {
    /// Each record takes this long.
    pub fn new(dataset: Dataset, delay: Duration) -> Arc<Watched> {
        let asked = Mutex::default();
        Arc::new(Watched {
            dataset,
            delay,
            asked,
        })
    }

    /// The pages asked for since the last call, in order.
    ///
    /// # Panics
    /// If a reader has.
    pub fn take_asked(&self) -> Vec<PageId> {
        std::mem::take(&mut *self.asked.lock().unwrap())
    }
}

impl PageSource for Watched {
    fn manifest(&self) -> &Manifest {
        self.dataset.manifest()
    }

    fn manifest_json(&self) -> &[u8] {
        self.dataset.manifest_json()
    }

    fn generation_id(&self) -> GenerationId {
        self.dataset.generation_id()
    }

    fn record(&self, page: PageId) -> Result<Option<Revised>, SourceError> {
        self.asked.lock().unwrap().push(page);
        std::thread::sleep(self.delay);
        PageSource::record(&self.dataset, page)
    }

    fn pack(&self, parent: PageId) -> Result<Option<Pack>, SourceError> {
        std::thread::sleep(self.delay);
        self.dataset.pack(parent)
    }
}
