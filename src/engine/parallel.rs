//! Loops over parts on the threads of the current rayon pool. Without the feature `parallel` the
//! same loops run on the calling thread, and give the same results.

#[cfg(feature = "parallel")]
pub(crate) use rayon::{current_num_threads, prelude};

#[cfg(not(feature = "parallel"))]
pub(crate) const fn current_num_threads() -> usize {
    1
}

/// Calls `work` on this thread, and on up to `helpers` others at the same time.
#[cfg(all(feature = "codec", feature = "parallel"))]
pub(crate) fn with_helpers(helpers: usize, work: &(dyn Fn() + Sync)) {
    rayon::in_place_scope(|scope| {
        for _ in 0..helpers {
            scope.spawn(|_| work());
        }
        work();
    });
}

/// Calls `work` once.
#[cfg(all(feature = "codec", not(feature = "parallel")))]
pub(crate) fn with_helpers(_helpers: usize, work: &(dyn Fn() + Sync)) {
    work();
}

/// The methods of rayon that are used here, by iterators of the standard library.
#[cfg(not(feature = "parallel"))]
pub(crate) mod prelude {
    pub(crate) trait Slice<T> {
        fn par_iter(&self) -> std::slice::Iter<'_, T>;
        fn par_chunks(&self, length: usize) -> std::slice::Chunks<'_, T>;
        fn par_chunks_mut(&mut self, length: usize) -> std::slice::ChunksMut<'_, T>;
    }

    impl<T> Slice<T> for [T] {
        fn par_iter(&self) -> std::slice::Iter<'_, T> {
            self.iter()
        }

        fn par_chunks(&self, length: usize) -> std::slice::Chunks<'_, T> {
            self.chunks(length)
        }

        fn par_chunks_mut(&mut self, length: usize) -> std::slice::ChunksMut<'_, T> {
            self.chunks_mut(length)
        }
    }

    pub(crate) trait Parallel: Iterator + Sized {
        fn into_par_iter(self) -> Self {
            self
        }

        /// One workspace instead of one for each thread.
        fn map_init<W, R>(
            self,
            init: impl FnOnce() -> W,
            mut map: impl FnMut(&mut W, Self::Item) -> R,
        ) -> impl Iterator<Item = R> {
            let mut workspace = init();
            self.map(move |item| map(&mut workspace, item))
        }

        fn try_for_each_init<W>(
            mut self,
            init: impl FnOnce() -> W,
            mut act: impl FnMut(&mut W, Self::Item) -> Option<()>,
        ) -> Option<()> {
            let mut workspace = init();
            self.try_for_each(|item| act(&mut workspace, item))
        }
    }

    impl<I: Iterator> Parallel for I {}
}
