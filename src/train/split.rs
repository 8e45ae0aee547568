//! The chunks of a data set: which are held out, and the order of the rest.

use crate::named::named;
use crate::net::tensor::{hash, seed_of};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// What is held out of training: a tenth, and at least one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Split {
    /// Whole scenes: none is on both sides.
    #[default]
    Scene,
    /// Chunks, as the paper does: other chunks of the same pictures are on both sides.
    Chunk,
}

named!(Split, "split", Scene = "scene", Chunk = "chunk");

/// A part of a noisy picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Chunk {
    /// The scene's place in the data set.
    pub picture: u32,
    /// Its noisy version.
    pub noisy: u32,
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
}

/// The chunks of side `side` of pictures of this size, on the fixed grid from the upper left.
pub fn chunks(pictures: u32, versions: u32, (width, height): (u32, u32), side: u32) -> Result<Vec<Chunk>> {
    if side == 0 || !width.is_multiple_of(side) || !height.is_multiple_of(side) {
        return Err(Error::input(format!(
            "pictures of {width}x{height} pixels are no whole number of chunks of {side}x{side}: make them so or choose another --crop"
        )));
    }
    let mut list = Vec::new();
    for (picture, noisy) in (0..pictures).flat_map(|p| (0..versions).map(move |k| (p, k))) {
        for (y, x) in
            (0..height).step_by(side as usize).flat_map(|y| (0..width).step_by(side as usize).map(move |x| (y, x)))
        {
            list.push(Chunk { picture, noisy, x, y });
        }
    }
    Ok(list)
}

/// Training and held-out chunks; both are sorted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sides {
    /// For training.
    pub training: Vec<Chunk>,
    /// Held out.
    pub held_out: Vec<Chunk>,
}

impl Split {
    /// Divides the chunks of `pictures` scenes.
    pub fn divide(self, chunks: &[Chunk], pictures: u32, seed: u64) -> Result<Sides> {
        let key = hash(seed, seed_of("split"));
        let of = |count: usize, what: &str| match count {
            0 | 1 => Err(Error::input(format!(
                "a split by {self} needs at least two {what}s, one to hold out; the data set has {count}"
            ))),
            _ => Ok(permutation(key, count).split_off(count - (count / 10).max(1))),
        };
        let held_out: std::collections::HashSet<Chunk> = match self {
            Self::Scene => {
                let scenes = of(pictures as usize, "scene")?;
                chunks.iter().filter(|c| scenes.contains(&c.picture)).copied().collect()
            }
            Self::Chunk => of(chunks.len(), "chunk")?.into_iter().map(|i| chunks[i as usize]).collect(),
        };
        let (mut held_out, mut training): (Vec<Chunk>, Vec<Chunk>) =
            chunks.iter().copied().partition(|c| held_out.contains(c));
        held_out.sort_unstable();
        training.sort_unstable();
        Ok(Sides { training, held_out })
    }
}

/// The numbers 0 to `count` - 1 in an order that follows from `key`.
#[must_use]
pub fn permutation(key: u64, count: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count as u32).collect();
    for i in (1..count).rev() {
        order.swap(i, (hash(key, i as u64) % (i as u64 + 1)) as usize);
    }
    order
}

/// The order in which the chunks come: a new permutation each epoch, one after the other.
pub struct Order {
    seed: u64,
    count: u64,
    epoch: Option<(u64, Vec<u32>)>,
}

impl Order {
    /// Of `count` chunks.
    ///
    /// # Panics
    /// Where there are none.
    #[must_use]
    pub fn new(seed: u64, count: usize) -> Self {
        assert!(count > 0);
        Self { seed, count: count as u64, epoch: None }
    }

    /// The index of the chunk at a place of the whole run.
    pub fn at(&mut self, place: u64) -> usize {
        let number = place / self.count;
        if self.epoch.as_ref().is_none_or(|(made, _)| *made != number) {
            let key = hash(hash(self.seed, seed_of("epoch")), number);
            self.epoch = Some((number, permutation(key, self.count as usize)));
        }
        let (_, order) = self.epoch.as_ref().expect("made above");
        order[(place % self.count) as usize] as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    fn all() -> Vec<Chunk> {
        chunks(12, 2, (96, 64), 32).expect("whole chunks")
    }

    #[test]
    fn chunks_tile_every_picture() {
        let list = all();
        assert_eq!(list.len(), 12 * 2 * 6);
        let mut covered = HashSet::new();
        for c in &list {
            for (x, y) in (0..32).flat_map(|x| (0..32).map(move |y| (x, y))) {
                assert!(c.x + x < 96 && c.y + y < 64);
                assert!(covered.insert((c.picture, c.noisy, c.x + x, c.y + y)));
            }
        }
        assert_eq!(covered.len(), 12 * 2 * 96 * 64);
        for side in [0, 33, 64] {
            assert!(chunks(1, 2, (96, 64), side).is_err(), "{side}");
        }
    }

    #[test]
    fn sides_are_disjoint_and_whole() {
        for split in [Split::Scene, Split::Chunk] {
            let sides = split.divide(&all(), 12, 5).expect("enough");
            let (a, b): (HashSet<_>, HashSet<_>) =
                (sides.training.iter().copied().collect(), sides.held_out.iter().copied().collect());
            assert!(a.is_disjoint(&b));
            assert_eq!(a.union(&b).count(), all().len());
            assert_eq!((a.len(), b.len()), (sides.training.len(), sides.held_out.len()));
            assert_eq!(sides, split.divide(&all(), 12, 5).expect("enough"));
            assert_ne!(sides, split.divide(&all(), 12, 6).expect("enough"));
            let held_out = if split == Split::Scene { 12 } else { 14 };
            assert_eq!(b.len(), held_out, "a tenth of 12 scenes, of 144 chunks");
        }
    }

    #[test]
    fn no_scene_is_on_both_sides_of_a_split_by_scene() {
        let scenes = |list: &[Chunk]| list.iter().map(|c| c.picture).collect::<HashSet<_>>();
        for seed in 0..50 {
            let sides = Split::Scene.divide(&all(), 12, seed).expect("enough");
            assert!(scenes(&sides.training).is_disjoint(&scenes(&sides.held_out)), "seed {seed}");
        }
        let sides = Split::Chunk.divide(&all(), 12, 0).expect("enough");
        assert!(!scenes(&sides.training).is_disjoint(&scenes(&sides.held_out)));
    }

    #[test]
    fn too_few_to_hold_one_out() {
        let one = chunks(1, 2, (32, 32), 32).expect("whole chunks");
        assert!(Split::Scene.divide(&one, 1, 0).unwrap_err().to_string().contains("at least two scenes"));
        let sides = Split::Chunk.divide(&one, 1, 0).expect("two chunks");
        assert_eq!((sides.training.len(), sides.held_out.len()), (1, 1));
        assert!(Split::Chunk.divide(&one[..1], 1, 0).is_err());
    }

    #[test]
    fn every_chunk_comes_once_an_epoch_in_a_new_order() {
        let (mut order, mut other) = (Order::new(1, 13), Order::new(2, 13));
        let mut epochs = Vec::new();
        for epoch in 0..20 {
            let places: Vec<usize> = (13 * epoch..13 * (epoch + 1)).map(|place| order.at(place)).collect();
            assert_eq!(places.iter().collect::<HashSet<_>>().len(), 13);
            assert!(!epochs.contains(&places));
            assert_ne!(places, (13 * epoch..13 * (epoch + 1)).map(|place| other.at(place)).collect::<Vec<_>>());
            epochs.push(places);
        }
        // Asked in any order, the same.
        assert_eq!(order.at(13 * 4 + 5), epochs[4][5]);
        assert_eq!(order.at(2), epochs[0][2]);
    }
}
