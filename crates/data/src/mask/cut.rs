//! Minimum cuts of pixel grids, by the algorithm of Boykov and Kolmogorov ("An Experimental Comparison of Min-Cut/Max-Flow
//! Algorithms for Energy Minimization in Vision", 2004): two trees grow from the terminals, flow is pushed where they
//! meet, and what loses its parent looks for another one.
//!
//! The grid is implicit, so that a pixel costs 60 bytes and no pointers; `docs/decisions/0025-minimum-cut.md` has why this
//! is ours.

use std::collections::VecDeque;

/// Steps to the eight neighbours; that of `7 − d` is opposite to that of `d`.
const STEPS: [(isize, isize); 8] = [
    (-1, -1),
    (0, -1),
    (1, -1),
    (-1, 0),
    (1, 0),
    (-1, 1),
    (0, 1),
    (1, 1),
];

/// Parents that are no neighbours.
const TERMINAL: u8 = 8;
const ORPHAN: u8 = 9;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Tree {
    Free,
    Source,
    Sink,
}

/// A grid of pixels between two terminals, and the flow through it so far.
pub(super) struct Grid {
    width: usize,
    height: usize,
    /// What can still flow from the source (positive) or to the sink (negative).
    terminal: Vec<f32>,
    /// What can still flow to each neighbour.
    residual: Vec<[f32; 8]>,
    tree: Vec<Tree>,
    /// The step towards the terminal.
    parent: Vec<u8>,
    /// How many steps it is to the terminal, as was true at the time of `stamp`.
    distance: Vec<u32>,
    stamp: Vec<u32>,
    time: u32,
    active: VecDeque<usize>,
    orphans: VecDeque<usize>,
}

impl Grid {
    /// A grid whose pixels cost `terminal` more on the sink's side than on the source's; negative costs are those of the
    /// source's side. All must be finite, `width · height` of them.
    pub fn new(width: usize, height: usize, terminal: Vec<f32>) -> Self {
        let count = width * height;
        assert_eq!(terminal.len(), count, "one cost a pixel");
        Self {
            width,
            height,
            terminal,
            residual: vec![[0.0; 8]; count],
            tree: vec![Tree::Free; count],
            parent: vec![ORPHAN; count],
            distance: vec![0; count],
            stamp: vec![0; count],
            time: 0,
            active: VecDeque::new(),
            orphans: VecDeque::new(),
        }
    }

    /// Sets what each pair of neighbours costs that the cut parts: `cost(p, q)` ≥ 0, of their indices.
    pub fn connect(&mut self, cost: impl Fn(usize, usize) -> f32) {
        for p in 0..self.terminal.len() {
            for d in 4..8 {
                if let Some(q) = self.neighbour(p, d) {
                    let cost = cost(p, q);
                    self.residual[p][d] = cost;
                    self.residual[q][7 - d] = cost;
                }
            }
        }
    }

    /// Finds the cut of the least cost; whether each pixel is on the source's side.
    pub fn cut(mut self) -> Vec<bool> {
        for p in 0..self.terminal.len() {
            if self.terminal[p] != 0.0 {
                let source = self.terminal[p] > 0.0;
                self.tree[p] = if source { Tree::Source } else { Tree::Sink };
                self.parent[p] = TERMINAL;
                self.distance[p] = 1;
                self.active.push_back(p);
            }
        }
        while let Some(&p) = self.active.front() {
            if self.tree[p] == Tree::Free {
                self.active.pop_front();
                continue;
            }
            match self.grow(p) {
                Some((from, d)) => {
                    self.time += 1;
                    self.augment(from, d);
                    while let Some(p) = self.orphans.pop_front() {
                        self.adopt(p);
                    }
                }
                None => {
                    self.active.pop_front();
                }
            }
        }
        self.tree.iter().map(|t| *t == Tree::Source).collect()
    }

    fn neighbour(&self, p: usize, d: usize) -> Option<usize> {
        let (x, y) = (p % self.width, p / self.width);
        let (dx, dy) = STEPS[d];
        let x = x.checked_add_signed(dx).filter(|x| *x < self.width)?;
        let y = y.checked_add_signed(dy).filter(|y| *y < self.height)?;
        Some(y * self.width + x)
    }

    /// What can flow between `p` and its neighbour `q` in step `d`, away from the terminal of `p`'s tree.
    fn away(&self, p: usize, d: usize, q: usize) -> f32 {
        match self.tree[p] {
            Tree::Source => self.residual[p][d],
            _ => self.residual[q][7 - d],
        }
    }

    /// Adds free neighbours to the tree of `p`. Where it meets the other tree: the source's pixel there and the step to the
    /// sink's.
    fn grow(&mut self, p: usize) -> Option<(usize, usize)> {
        for d in 0..8 {
            let Some(q) = self.neighbour(p, d) else {
                continue;
            };
            if self.away(p, d, q) <= 0.0 {
                continue;
            }
            if self.tree[q] == Tree::Free {
                self.tree[q] = self.tree[p];
                self.hang(q, 7 - d, self.distance[p] + 1, self.stamp[p]);
                self.active.push_back(q);
            } else if self.tree[q] != self.tree[p] {
                return Some(match self.tree[p] {
                    Tree::Source => (p, d),
                    _ => (q, 7 - d),
                });
            } else if self.stamp[q] <= self.stamp[p] && self.distance[q] > self.distance[p] + 1 {
                // A shorter way to the terminal.
                self.hang(q, 7 - d, self.distance[p] + 1, self.stamp[p]);
            }
        }
        None
    }

    fn hang(&mut self, p: usize, parent: usize, distance: u32, stamp: u32) {
        self.parent[p] = parent as u8;
        self.distance[p] = distance;
        self.stamp[p] = stamp;
    }

    /// Pixels from `p` to its terminal, each with the step to the next one; [`TERMINAL`] with the last.
    fn path(&self, p: usize) -> impl Iterator<Item = (usize, u8)> + use<> {
        let mut steps = Vec::new();
        let mut at = Some(p);
        while let Some(p) = at {
            let step = self.parent[p];
            steps.push((p, step));
            at = (step < TERMINAL)
                .then(|| self.neighbour(p, step as usize))
                .flatten();
        }
        steps.into_iter()
    }

    /// Pushes what flows from the source through `from`, in step `d`, and on to the sink.
    fn augment(&mut self, from: usize, d: usize) {
        let Some(to) = self.neighbour(from, d) else {
            return;
        };
        let mut most = self.residual[from][d];
        for (p, step) in self.path(from) {
            most = most.min(self.towards(p, step, Tree::Source));
        }
        for (p, step) in self.path(to) {
            most = most.min(self.towards(p, step, Tree::Sink));
        }
        self.residual[from][d] -= most;
        self.residual[to][7 - d] += most;
        for (start, tree) in [(from, Tree::Source), (to, Tree::Sink)] {
            for (p, step) in self.path(start) {
                self.push(p, step, tree, most);
                if self.towards(p, step, tree) <= 0.0 {
                    self.parent[p] = ORPHAN;
                    self.orphans.push_front(p);
                }
            }
        }
    }

    /// What can flow between `p` and what its `step` leads to, away from the source or towards the sink.
    fn towards(&self, p: usize, step: u8, tree: Tree) -> f32 {
        let d = step as usize;
        match (tree, self.neighbour(p, d.min(7))) {
            (Tree::Source, _) if step == TERMINAL => self.terminal[p],
            (_, _) if step == TERMINAL => -self.terminal[p],
            (Tree::Source, Some(q)) => self.residual[q][7 - d],
            (_, Some(_)) => self.residual[p][d],
            (_, None) => 0.0,
        }
    }

    fn push(&mut self, p: usize, step: u8, tree: Tree, flow: f32) {
        let d = step as usize;
        if step == TERMINAL {
            self.terminal[p] -= if tree == Tree::Source { flow } else { -flow };
        } else if let Some(q) = self.neighbour(p, d) {
            let sign = if tree == Tree::Source { -flow } else { flow };
            self.residual[p][d] -= sign;
            self.residual[q][7 - d] += sign;
        }
    }

    /// Finds a new parent for `p`, the nearest to the terminal, or frees it and orphans its children.
    fn adopt(&mut self, p: usize) {
        let mut best: Option<(u32, usize)> = None;
        for d in 0..8 {
            let Some(q) = self.neighbour(p, d) else {
                continue;
            };
            if self.tree[q] != self.tree[p] || self.away(q, 7 - d, p) <= 0.0 {
                continue;
            }
            if let Some(distance) = self.rooted(q)
                && best.is_none_or(|(least, _)| distance < least)
            {
                best = Some((distance, d));
            }
        }
        if let Some((distance, d)) = best {
            self.hang(p, d, distance + 1, self.time);
            return;
        }
        for d in 0..8 {
            let Some(q) = self.neighbour(p, d) else {
                continue;
            };
            if self.tree[q] != self.tree[p] {
                continue;
            }
            if self.away(q, 7 - d, p) > 0.0 {
                self.active.push_back(q);
            }
            if self.parent[q] as usize == 7 - d {
                self.parent[q] = ORPHAN;
                self.orphans.push_back(q);
            }
        }
        self.tree[p] = Tree::Free;
    }

    /// Steps from `p` to its terminal; `None` if it has lost the way. Marks the way, so that the next one need not go it.
    fn rooted(&mut self, p: usize) -> Option<u32> {
        let (mut at, mut steps) = (p, 0);
        loop {
            if self.stamp[at] == self.time {
                steps += self.distance[at];
                break;
            }
            steps += 1;
            match self.parent[at] {
                ORPHAN => return None,
                TERMINAL => break,
                step => at = self.neighbour(at, step as usize)?,
            }
        }
        let (mut at, mut left) = (p, steps);
        while self.stamp[at] != self.time {
            self.stamp[at] = self.time;
            self.distance[at] = left;
            left -= 1;
            match self.parent[at] {
                TERMINAL => break,
                step => at = self.neighbour(at, step as usize)?,
            }
        }
        Some(steps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::Seed;

    /// What a labelling costs.
    fn cost(size: (usize, usize), terminal: &[f32], between: &[f32], source: &[bool]) -> f64 {
        let grid = Grid::new(size.0, size.1, terminal.to_vec());
        let mut sum = 0.0;
        for p in 0..source.len() {
            let wrong = source[p] != (terminal[p] > 0.0);
            sum += f64::from(if wrong { terminal[p].abs() } else { 0.0 });
            for d in 4..8 {
                let parted = grid.neighbour(p, d).filter(|q| source[p] != source[*q]);
                sum += f64::from(parted.map_or(0.0, |q| between[p * source.len() + q]));
            }
        }
        sum
    }

    /// Numbers from 0 to 15.
    fn numbers(seed: u64) -> impl FnMut() -> f32 {
        let mut index = 0;
        move || {
            index += 1;
            (Seed(seed).index(index).0 % 16) as f32
        }
    }

    #[test]
    fn no_labelling_of_small_grids_costs_less() {
        let mut number = numbers(7);
        for round in 0..400 {
            let size = [(3, 3), (4, 2), (1, 6), (4, 3)][round % 4];
            let count = size.0 * size.1;
            let terminal: Vec<f32> = (0..count).map(|_| number() - 8.0).collect();
            let between: Vec<f32> = (0..count * count)
                .map(|_| (number() - 5.0).max(0.0))
                .collect();
            let mut grid = Grid::new(size.0, size.1, terminal.clone());
            grid.connect(|p, q| between[p * count + q]);
            let found = cost(size, &terminal, &between, &grid.cut());
            let least = (0..1_u32 << count)
                .map(|bits| {
                    let source: Vec<bool> = (0..count).map(|p| bits >> p & 1 == 1).collect();
                    cost(size, &terminal, &between, &source)
                })
                .fold(f64::INFINITY, f64::min);
            assert_eq!(found, least, "round {round}");
        }
    }

    #[test]
    fn a_noisy_disc_is_cut_whole() {
        let side = 200;
        let inside = |p: usize| {
            let at = |v: usize| v as f32 - 99.5;
            at(p % side).hypot(at(p / side)) < 60.0
        };
        let mut number = numbers(3);
        let terminal = (0..side * side)
            .map(|p| if inside(p) { 3.0 } else { -3.0 } + number() - 7.5)
            .collect();
        let mut grid = Grid::new(side, side, terminal);
        grid.connect(|_, _| 4.0);
        let found = grid.cut();
        let wrong = (0..side * side).filter(|p| found[*p] != inside(*p)).count();
        assert!(wrong < 150, "{wrong} of {} pixels", side * side);
    }
}
