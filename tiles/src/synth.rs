//! A deterministic synthetic DEM (being written).
