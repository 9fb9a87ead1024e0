//! The stand-in for `otlp_client` in a build without the feature `otlp`: no text is the address of
//! a collector.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::trace::{SpanData, SpanExporter};

const MISSING: &str = "this build has no export of traces";

/// Never made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CollectorUrl(());

impl fmt::Display for CollectorUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(MISSING)
    }
}

impl SpanExporter for CollectorUrl {
    async fn export(&self, _: Vec<SpanData>) -> OTelSdkResult {
        Ok(())
    }
}

pub(crate) fn parse_collector(_: &str) -> Result<CollectorUrl, String> {
    Err(MISSING.to_owned())
}

pub(super) fn exporter(
    _: &CollectorUrl,
    _: &Resource,
) -> Result<(CollectorUrl, Arc<AtomicU64>), String> {
    Err(MISSING.to_owned())
}
