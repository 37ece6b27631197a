//! Union-find: which of many things were joined, directly or through others.

/// Sets of numbers, the root of each being its lowest, so that roots do not depend on the order of joining.
#[derive(Clone, Debug, Default)]
pub(crate) struct DisjointSets {
    /// A member of the same set that is nearer to the root; the root's is itself.
    parent: Vec<u32>,
}

impl DisjointSets {
    /// A set for each of the numbers below `count`.
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// The next number, in a set of its own.
    pub fn add(&mut self) -> u32 {
        let new = self.parent.len() as u32;
        self.parent.push(new);
        new
    }

    /// The root of the set that a number is in. What is passed on the way comes nearer to it (path halving).
    pub fn root(&mut self, mut member: u32) -> u32 {
        while self.parent[member as usize] != member {
            let grandparent = self.parent[self.parent[member as usize] as usize];
            self.parent[member as usize] = grandparent;
            member = grandparent;
        }
        member
    }

    /// The roots of all sets, ascending.
    pub fn roots(&self) -> impl Iterator<Item = u32> {
        (0..self.parent.len() as u32).filter(|&member| self.parent[member as usize] == member)
    }

    /// Joins the sets of two numbers: the root that stays, and the other one, which is the same if they were joined
    /// already.
    pub fn join(&mut self, a: u32, b: u32) -> [u32; 2] {
        let (a, b) = (self.root(a), self.root(b));
        let [stays, goes] = [a.min(b), a.max(b)];
        self.parent[goes as usize] = stays;
        [stays, goes]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_is_the_root_in_whatever_order_sets_are_joined() {
        for pairs in [[[5, 3], [1, 5], [4, 2]], [[4, 2], [1, 3], [3, 5]]] {
            let mut sets = DisjointSets::new(5);
            assert_eq!(sets.add(), 5);
            pairs.into_iter().for_each(|[a, b]| _ = sets.join(a, b));
            assert_eq!([0, 1, 2, 3, 4, 5].map(|i| sets.root(i)), [0, 1, 2, 1, 2, 1]);
            assert_eq!(sets.roots().collect::<Vec<_>>(), [0, 1, 2]);
            assert_eq!([sets.join(3, 5), sets.join(2, 5)], [[1, 1], [1, 2]]);
        }
    }
}
