//! Escarp.
