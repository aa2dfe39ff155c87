// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

/// @title A binary max-heap in memory
/// @notice Algorithm 2 takes the best proposals until the bandwidth is spent: a heap orders only those that are
/// looked at, and its worst case is n log n whatever order an attacker submits in.
library ProposalHeap {
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
                uint256 word = heap[i];
                if (uint32(word) <= left) heap[kept++] = word;
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
            let word := mload(place)
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
                if iszero(gt(best, word)) { break }
                mstore(place, best)
                place := child
            }
            mstore(place, word)
        }
    }
}
