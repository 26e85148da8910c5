//! Pictures of two values: grown, shrunk, flooded, taken apart.

/// A picture of two values.
pub(super) struct Mask {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Row-major.
    pub(super) on: Vec<bool>,
}

impl Mask {
    /// Pixels that are on.
    pub(super) fn count(&self) -> usize {
        self.on.iter().filter(|on| **on).count()
    }

    /// On wherever a pixel within `by` pixels, across and down, is.
    pub(super) fn grown(&self, by: usize) -> Self {
        let along = |on: &[bool], width: usize, height: usize| -> Vec<bool> {
            let mut turned = vec![false; width * height];
            for (y, row) in on.chunks_exact(width).enumerate() {
                // How many are on from `x - by` to `x + by`, as x goes along.
                let mut count = row.iter().take(by).filter(|on| **on).count();
                for x in 0..width {
                    count += usize::from(row.get(x + by).is_some_and(|on| *on));
                    // Turned over as it goes: the second time puts rows and columns back.
                    turned[x * height + y] = count > 0;
                    count -= usize::from(x >= by && row[x - by]);
                }
            }
            turned
        };
        let across = along(&self.on, self.width, self.height);
        Self { on: along(&across, self.height, self.width), ..*self }
    }

    /// Off wherever a pixel within `by` pixels, across and down, is.
    pub(super) fn shrunk(&self, by: usize) -> Self {
        let off = Self { on: self.on.iter().map(|on| !on).collect(), ..*self };
        Self { on: off.grown(by).on.iter().map(|on| !on).collect(), ..*self }
    }

    /// Grown step by step, to the sides, into pixels that are `open`.
    pub(super) fn flooded(&self, open: impl Fn(usize) -> bool) -> Self {
        let mut on = self.on.clone();
        self.reach((0..on.len()).filter(|at| self.on[*at]).collect(), &mut on, open);
        Self { on, ..*self }
    }

    /// Its connected parts that are `kept`.
    pub(super) fn parts_where(&self, kept: impl Fn(&[usize]) -> bool) -> Self {
        let mut left = vec![false; self.on.len()];
        let mut seen = left.clone();
        for start in 0..self.on.len() {
            if !self.on[start] || seen[start] {
                continue;
            }
            seen[start] = true;
            let part = self.reach(vec![start], &mut seen, |at| self.on[at]);
            if kept(&part) {
                part.iter().for_each(|at| left[*at] = true);
            }
        }
        Self { on: left, ..*self }
    }

    /// Of the pixels of `part` that have neighbours out of it, the share that lies in `ends`; 0 where it fills the frame.
    pub(super) fn share_of_rim(&self, part: &[usize], ends: &Self) -> f64 {
        let rim = || part.iter().filter(|at| self.sides(**at).any(|side| !self.on[side]));
        rim().filter(|at| ends.on[**at]).count() as f64 / rim().count().max(1) as f64
    }

    /// Pixels beside `at`, above and below.
    fn sides(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let (x, y, width) = (at % self.width, at / self.width, self.width);
        let sides = [
            (x > 0).then(|| at - 1),
            (x + 1 < width).then(|| at + 1),
            (y > 0).then(|| at - width),
            (y + 1 < self.height).then(|| at + width),
        ];
        sides.into_iter().flatten()
    }

    /// Goes from `starts`, which are `seen`, to the sides through what is `open` and not yet seen; all that was reached.
    fn reach(&self, starts: Vec<usize>, seen: &mut [bool], open: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut reached = starts;
        let mut next = 0;
        while let Some(at) = reached.get(next).copied() {
            next += 1;
            for side in self.sides(at) {
                if !seen[side] && open(side) {
                    seen[side] = true;
                    reached.push(side);
                }
            }
        }
        reached
    }
}
