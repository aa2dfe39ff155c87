// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// @title A binary max-heap in memory
/// @notice Algorithm 2 takes the best proposals until the bandwidth is spent: a heap orders only those that are
/// looked at, and its worst case is n log n whatever order an attacker submits in.
library ProposalHeap {
    /// @notice A proposal in one word, the larger the better: score, then the earlier place; below them a number, by
    /// which the caller knows it again, and the demand.
    function word(uint256 score, uint256 place, uint256 number, uint256 demand) internal pure returns (uint256) {
        unchecked {
            return score << 192 | (type(uint16).max - place) << 176 | number << 32 | demand;
        }
    }

    /// @notice Algorithm 2 over proposals in any order: the best that fits into `bandwidth`, and again.
    /// @param bits gets the bit of each place that is taken.
    /// @return taken how many; their numbers stand at the end of `heap`, the first one last.
    /// @return left of the bandwidth.
    function take(uint256[] memory heap, uint256[] memory bits, uint256 bandwidth)
        internal
        pure
        returns (uint256 taken, uint256 left)
    {
        left = bandwidth;
        uint256 size = heap.length;
        build(heap, size);
        uint256 misfits = 0;
        uint256 patience = 1;
        while (size != 0) {
            uint256 best = pop(heap, size);
            unchecked {
                --size;
                uint256 demand = uint32(best);
                if (demand > left) {
                    // What does not fit now never will. Doubling the patience bounds the passes by log n.
                    if (++misfits == patience) {
                        size = keepFitting(heap, size, left);
                        patience <<= 1;
                        misfits = 0;
                    }
                    continue;
                }
                left -= demand;
                uint256 place = type(uint16).max - uint16(best >> 176);
                bits[place >> 8] |= 1 << (place & 0xff);
                // Each proposal that is popped leaves a word free at the end.
                heap[heap.length - ++taken] = uint16(best >> 32);
            }
        }
    }

    /// @notice Order the first `size` words so that the largest is first. O(n).
    function build(uint256[] memory heap, uint256 size) internal pure {
        unchecked {
            for (uint256 i = size >> 1; i > 0; --i) {
                siftDown(heap, i - 1, size);
            }
        }
    }

    /// @notice Drop those of the first `size` words whose low 32 bits, the demand, exceed `left`; how many remain. O(n).
    function keepFitting(uint256[] memory heap, uint256 size, uint256 left) internal pure returns (uint256 kept) {
        unchecked {
            for (uint256 i = 0; i < size; ++i) {
                uint256 each = heap[i];
                if (uint32(each) <= left) heap[kept++] = each;
            }
        }
        build(heap, kept);
    }

    /// @notice Take the largest of the first `size` words out; `size - 1` remain. O(log n).
    function pop(uint256[] memory heap, uint256 size) internal pure returns (uint256 top) {
        unchecked {
            top = heap[0];
            heap[0] = heap[size - 1];
            siftDown(heap, 0, size - 1);
        }
    }

    /// @dev In assembly without bounds checks: `hole < size <= heap.length` holds at both callers, and a child is read
    /// only where it is below `size`. This loop is most of an allocation's gas after the storage reads.
    // slither-disable-next-line assembly
    function siftDown(uint256[] memory heap, uint256 hole, uint256 size) private pure {
        assembly ("memory-safe") {
            let base := add(heap, 0x20)
            let end := add(base, shl(5, size))
            let place := add(base, shl(5, hole))
            let moved := mload(place)
            for {} 1 {} {
                // base + 2 * (place - base) + 0x20, the left child
                let child := add(sub(shl(1, place), base), 0x20)
                if iszero(lt(child, end)) { break }
                let best := mload(child)
                let right := add(child, 0x20)
                if lt(right, end) {
                    let other := mload(right)
                    if gt(other, best) {
                        best := other
                        child := right
                    }
                }
                if iszero(gt(best, moved)) { break }
                mstore(place, best)
                place := child
            }
            mstore(place, moved)
        }
    }
}
