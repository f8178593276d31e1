//! Removal from short ordered lists.
//!
//! `heapless::Vec::remove` has checks that the compiler cannot remove, and so links a panic into a firmware that must
//! not have one.

use heapless::Vec;

/// Removes and returns the first element for which `test` returns true. The others keep their order.
pub(crate) fn take_first<T: Clone, const N: usize>(
    list: &mut Vec<T, N, u8>,
    mut test: impl FnMut(&T) -> bool,
) -> Option<T> {
    let mut taken = None;
    let mut rest = list.as_mut_slice();
    while let [first, tail @ ..] = rest {
        if taken.is_none() && test(first) {
            taken = Some(first.clone());
        }
        if taken.is_some()
            && let Some(next) = tail.first()
        {
            first.clone_from(next);
        }
        rest = tail;
    }
    if taken.is_some() {
        // Now the last element is a duplicate, or the one that was taken.
        list.pop();
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_match_is_removed_and_the_others_keep_their_order() {
        let full = [1, 2, 3, 4, 5, 6];
        for (wanted, left) in [(1, [2, 3, 4, 5, 6]), (3, [1, 2, 4, 5, 6]), (6, [1, 2, 3, 4, 5])] {
            let mut list = Vec::<i32, 6, u8>::from_array(full);
            assert_eq!(take_first(&mut list, |element| *element >= wanted), Some(wanted));
            assert_eq!(list, left);
        }
    }

    #[test]
    fn nothing_is_removed_without_a_match() {
        let mut list = Vec::<_, 4, u8>::from_array([1, 2, 3]);
        assert_eq!(take_first(&mut list, |element| *element > 3), None);
        assert_eq!(list, [1, 2, 3]);
        assert_eq!(take_first(&mut Vec::<i32, 4, u8>::new(), |_| true), None);
    }
}
