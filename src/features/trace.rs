//! Joins segments into chains as long as they go.

/// A piece between two nodes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Segment {
    pub ends: [u32; 2],
    /// Where it lies: a face.
    pub face: u32,
}

/// Segments in a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chain {
    /// At least two; of a closed chain the first comes last again.
    pub nodes: Vec<u32>,
    /// `[nodes − 1]`: the segments between them.
    pub segments: Vec<u32>,
}

impl Chain {
    pub fn is_closed(&self) -> bool {
        self.nodes.first() == self.nodes.last()
    }
}

/// All chains of some segments: they end at nodes where one, or more than two, segments meet.
pub(super) fn chains(segments: &[Segment], node_count: usize) -> Vec<Chain> {
    let incidence = Incidence::of(segments, node_count);
    let mut is_used = vec![false; segments.len()];
    let mut chains = Vec::new();
    // Closed ones are those that no end leads to.
    for from_ends in [true, false] {
        for (s, segment) in segments.iter().enumerate() {
            for start in segment.ends {
                if !is_used[s] && (!from_ends || incidence.at(start).len() != 2) {
                    chains.push(walk(segments, &incidence, &mut is_used, start, s as u32));
                }
            }
        }
    }
    chains
}

fn walk(
    segments: &[Segment],
    incidence: &Incidence,
    is_used: &mut [bool],
    start: u32,
    first: u32,
) -> Chain {
    let mut chain = Chain {
        nodes: vec![start],
        segments: Vec::new(),
    };
    let mut next = Some(first);
    let mut at = start;
    while let Some(s) = next {
        is_used[s as usize] = true;
        let [a, b] = segments[s as usize].ends;
        at = if at == a { b } else { a };
        chain.nodes.push(at);
        chain.segments.push(s);
        next = match incidence.at(at) {
            [s, t] => [*s, *t].into_iter().find(|&s| !is_used[s as usize]),
            _ => None,
        };
    }
    chain
}

/// The segments at every node.
struct Incidence {
    offsets: Vec<u32>,
    segments: Vec<u32>,
}

impl Incidence {
    fn of(segments: &[Segment], node_count: usize) -> Self {
        let mut offsets = vec![0; node_count + 1];
        for segment in segments {
            for end in segment.ends {
                offsets[end as usize + 1] += 1;
            }
        }
        for node in 0..node_count {
            offsets[node + 1] += offsets[node];
        }
        let mut next = offsets.clone();
        let mut at = vec![0; 2 * segments.len()];
        for (s, segment) in segments.iter().enumerate() {
            for end in segment.ends {
                at[next[end as usize] as usize] = s as u32;
                next[end as usize] += 1;
            }
        }
        Self {
            offsets,
            segments: at,
        }
    }

    fn at(&self, node: u32) -> &[u32] {
        let range = self.offsets[node as usize] as usize..self.offsets[node as usize + 1] as usize;
        &self.segments[range]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn traced(ends: &[[u32; 2]]) -> Vec<Vec<u32>> {
        let segments: Vec<_> = ends.iter().map(|&ends| Segment { ends, face: 0 }).collect();
        chains(&segments, 10)
            .into_iter()
            .map(|chain| chain.nodes)
            .collect()
    }

    #[test]
    fn chains_end_at_ends_and_forks_and_close() {
        assert!(traced(&[]).is_empty());
        assert_eq!(traced(&[[3, 1], [1, 2]]), [[3, 1, 2]]);
        assert_eq!(traced(&[[0, 1], [1, 2], [2, 0]]), [[0, 1, 2, 0]]);
        assert_eq!(traced(&[[0, 1], [1, 2], [1, 3]]), [[0, 1], [1, 2], [1, 3]]);
        // A loop that hangs on a fork, a double segment, and a segment of one node.
        assert_eq!(
            traced(&[[0, 1], [1, 2], [2, 1]]),
            [vec![0, 1], vec![1, 2, 1]]
        );
        assert_eq!(traced(&[[4, 5], [5, 4]]), [[4, 5, 4]]);
        assert_eq!(traced(&[[7, 7]]), [[7, 7]]);
    }
}
