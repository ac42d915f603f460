//! Updates: a dataset that was patched is the one that would have been built from the merged
//! inputs, page for page; it costs what the patch costs; and no reader of it is disturbed.

mod case;
mod generations;
mod merged;
mod published;
