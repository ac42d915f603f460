//! Runs of bytes in a few large GPU buffers, and one staging buffer for all that a frame uploads.

use super::buddy::{Buddy, order_of};
use super::gpu::Gpu;

/// Staged bytes beyond which an upload is sent off at once.
const STAGING_BYTES: usize = 32 << 20;

/// A run of bytes in one of a pool's blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Run {
    /// Number of the block.
    pub block: u32,
    /// First unit in the block.
    pub unit: u32,
    order: u8,
}

/// Buffers of one kind, each of `2^block_order` units. Grows by a block, and never copies.
pub struct Pool {
    label: &'static str,
    usage: wgpu::BufferUsages,
    unit_bytes: u32,
    block_order: u8,
    blocks: Vec<(wgpu::Buffer, Buddy)>,
}

impl Pool {
    pub fn new(
        label: &'static str,
        usage: wgpu::BufferUsages,
        unit_bytes: u32,
        block_order: u8,
    ) -> Pool {
        Pool {
            label,
            usage: usage | wgpu::BufferUsages::COPY_DST,
            unit_bytes,
            block_order,
            blocks: Vec::new(),
        }
    }

    /// A run that holds this many bytes.
    ///
    /// # Panics
    /// If a whole block does not hold them.
    pub fn take(&mut self, gpu: &Gpu, bytes: usize) -> Run {
        let order = order_of((bytes as u32).div_ceil(self.unit_bytes));
        assert!(
            order <= self.block_order,
            "{bytes} bytes for {}",
            self.label
        );
        let held = (0..).zip(&mut self.blocks);
        let found = held
            .filter_map(|(block, (_, buddy))| Some((block, buddy.take(order)?)))
            .next();
        let (block, unit) =
            found.unwrap_or_else(|| (self.blocks.len() as u32, self.grow(gpu, order)));
        Run { block, unit, order }
    }

    fn grow(&mut self, gpu: &Gpu, order: u8) -> u32 {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(self.label),
            size: u64::from(self.unit_bytes) << self.block_order,
            usage: self.usage,
            mapped_at_creation: false,
        });
        let mut buddy = Buddy::new(self.block_order);
        let unit = buddy.take(order).unwrap_or(0);
        self.blocks.push((buffer, buddy));
        unit
    }

    /// Gives a run back.
    pub fn give(&mut self, run: Run) {
        self.blocks[run.block as usize].1.give(run.unit, run.order);
    }

    /// Whether these bytes fit the run, and it is not four times too large for them.
    pub fn suits(&self, run: Run, bytes: usize) -> bool {
        let order = order_of((bytes as u32).div_ceil(self.unit_bytes));
        order <= run.order && run.order <= order + 1
    }

    /// A block's buffer.
    pub fn buffer(&self, block: u32) -> &wgpu::Buffer {
        &self.blocks[block as usize].0
    }

    fn offset(&self, run: Run) -> u64 {
        u64::from(run.unit) * u64::from(self.unit_bytes)
    }
}

/// A second buffer for each block of a pool, so that what lies there is found by the same runs.
pub struct Twin {
    label: &'static str,
    usage: wgpu::BufferUsages,
    unit_bytes: u32,
    blocks: Vec<wgpu::Buffer>,
}

impl Twin {
    pub fn new(label: &'static str, usage: wgpu::BufferUsages, unit_bytes: u32) -> Twin {
        Twin {
            label,
            usage: usage | wgpu::BufferUsages::COPY_DST,
            unit_bytes,
            blocks: Vec::new(),
        }
    }

    /// Takes a buffer, of zeros, for each block of the pool that has none.
    pub fn follow(&mut self, gpu: &Gpu, pool: &Pool) {
        while self.blocks.len() < pool.blocks.len() {
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(self.label),
                size: u64::from(self.unit_bytes) << pool.block_order,
                usage: self.usage,
                mapped_at_creation: false,
            });
            self.blocks.push(buffer);
        }
    }

    /// A block's buffer.
    pub fn buffer(&self, block: u32) -> &wgpu::Buffer {
        &self.blocks[block as usize]
    }
}

/// Collects a frame's uploads, so that they cost one buffer and one submission.
#[derive(Default)]
pub struct Staging {
    data: Vec<u8>,
    copies: Vec<Copy>,
    /// Bytes staged in all.
    pub bytes: u64,
}

struct Copy {
    to: wgpu::Buffer,
    at: u64,
    from: u64,
    len: u64,
}

impl Staging {
    /// Stages bytes for a run. An odd end is padded to the four bytes that copies need.
    pub fn put(&mut self, gpu: &Gpu, pool: &Pool, run: Run, bytes: &[u8]) {
        self.put_at(gpu, pool.buffer(run.block), pool.offset(run), bytes);
    }

    /// The same for a run in a pool's twin.
    pub fn put_beside(&mut self, gpu: &Gpu, twin: &Twin, run: Run, bytes: &[u8]) {
        let at = u64::from(run.unit) * u64::from(twin.unit_bytes);
        self.put_at(gpu, twin.buffer(run.block), at, bytes);
    }

    fn put_at(&mut self, gpu: &Gpu, to: &wgpu::Buffer, at: u64, bytes: &[u8]) {
        let from = self.data.len();
        self.data.extend_from_slice(bytes);
        self.data.resize(self.data.len().next_multiple_of(4), 0);
        self.copies.push(Copy {
            to: to.clone(),
            at,
            from: from as u64,
            len: (self.data.len() - from) as u64,
        });
        self.bytes += bytes.len() as u64;
        if self.data.len() >= STAGING_BYTES {
            self.send(gpu);
        }
    }

    /// Sends off all that is staged.
    pub fn send(&mut self, gpu: &Gpu) {
        if self.copies.is_empty() {
            return;
        }
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("staging"),
            size: self.data.len() as u64,
            usage: wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: true,
        });
        if let Ok(mut view) = buffer.get_mapped_range_mut(..) {
            view.copy_from_slice(&self.data);
        }
        buffer.unmap();
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        for copy in self.copies.drain(..) {
            encoder.copy_buffer_to_buffer(&buffer, copy.from, &copy.to, copy.at, Some(copy.len));
        }
        gpu.queue.submit([encoder.finish()]);
        self.data.clear();
    }
}
