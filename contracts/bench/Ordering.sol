// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ProposalHeap} from "../src/libraries/ProposalHeap.sol";

/// @notice Three ways to take one UAV's proposals in descending order, each with the storage that it needs and nothing
/// else. docs/decisions/0011-contract-ordering.md has the figures and the choice.
contract Ordering {
    /// @dev demand 0:32, score 32:64, next 96:16 (in the ordered list), vehicle 112:144.
    uint256[1025] private _proposals;
    /// @dev count 0:16, head 16:16, progress of the order from outside: processed 32:16, last score 48:64, last index
    /// 112:16, left 128:32.
    uint256 private _state;
    uint256[4] private _selected;

    function reset() external {
        _state = 1 << 200;
    }

    function submit(uint64 score, uint32 demand) external {
        uint256 count = uint16(_state);
        _proposals[count + 1] = uint256(uint160(msg.sender)) << 112 | uint256(score) << 32 | demand;
        _state += 1;
    }

    // 1. Sorted in memory when it is allocated: a heap (src), and insertion for comparison.

    function allocateByHeap(uint256 left) external {
        uint256 count = uint16(_state);
        uint256[] memory heap = new uint256[](count);
        for (uint256 i = 0; i < count; ++i) {
            heap[i] = _key(_proposals[i + 1], i);
        }
        ProposalHeap.build(heap, count);
        uint256[4] memory bits;
        uint256 misfits = 0;
        uint256 patience = 1;
        for (uint256 size = count; size != 0;) {
            uint256 best = ProposalHeap.pop(heap, size--);
            uint256 after_ = _take(best, left, bits);
            if (after_ == left && ++misfits == patience) {
                size = ProposalHeap.keepFitting(heap, size, left);
                patience <<= 1;
                misfits = 0;
            }
            left = after_;
        }
        _selected = bits;
    }

    function allocateByInsertion(uint256 left) external {
        uint256 count = uint16(_state);
        uint256[] memory words = new uint256[](count);
        unchecked {
            for (uint256 i = 0; i < count; ++i) {
                uint256 word = _key(_proposals[i + 1], i);
                uint256 hole = i;
                for (; hole != 0 && words[hole - 1] < word; --hole) {
                    words[hole] = words[hole - 1];
                }
                words[hole] = word;
            }
        }
        uint256[4] memory bits;
        for (uint256 i = 0; i < count; ++i) {
            left = _take(words[i], left, bits);
        }
        _selected = bits;
    }

    // 2. Kept in order when it is submitted: a linked list; the submitter names the place, the contract checks it.

    /// @param before the place (from 1; 0 is the head) after which the proposal stands.
    function submitInOrder(uint64 score, uint32 demand, uint16 before) external {
        uint256 state = _state;
        uint256 place = uint16(state) + 1;
        uint256 next;
        if (before == 0) {
            next = uint16(state >> 16);
            state = state & ~(uint256(0xffff) << 16) | place << 16;
        } else {
            uint256 previous = _proposals[before];
            require(uint64(previous >> 32) >= score, "not after the better one");
            next = uint16(previous >> 96);
            _proposals[before] = previous & ~(uint256(0xffff) << 96) | place << 96;
        }
        require(next == 0 || uint64(_proposals[next] >> 32) < score, "not before the worse one");
        _proposals[place] = uint256(uint160(msg.sender)) << 112 | next << 96 | uint256(score) << 32 | demand;
        _state = state + 1;
    }

    function allocateInOrder(uint256 left) external {
        uint256[4] memory bits;
        for (uint256 place = uint16(_state >> 16); place != 0;) {
            uint256 proposal = _proposals[place];
            left = _take(_key(proposal, place - 1), left, bits);
            place = uint16(proposal >> 96);
        }
        _selected = bits;
    }

    // 3. The order comes from outside and is checked: strictly descending keys, as many as there are proposals.

    /// @param order two bytes an index.
    function allocateByGivenOrder(uint256 left, bytes calldata order) external {
        uint256 count = uint16(_state);
        require(order.length == 2 * count, "incomplete");
        uint256[4] memory bits;
        uint256 last = type(uint256).max;
        for (uint256 i = 0; i < count; ++i) {
            uint256 index = uint16(bytes2(order[2 * i:]));
            require(index < count, "unknown");
            uint256 key = _key(_proposals[index + 1], index);
            require(key < last, "not descending");
            last = key;
            left = _take(key, left, bits);
        }
        _selected = bits;
    }

    function _key(uint256 proposal, uint256 index) private pure returns (uint256) {
        return uint256(uint64(proposal >> 32)) << 192 | (type(uint16).max - index) << 176 | uint32(proposal);
    }

    function _take(uint256 key, uint256 left, uint256[4] memory bits) private pure returns (uint256) {
        unchecked {
            uint256 demand = uint32(key);
            if (demand > left) return left;
            uint256 index = type(uint16).max - uint16(key >> 176);
            bits[index >> 8] |= 1 << (index & 0xff);
            return left - demand;
        }
    }

    function selected() external view returns (uint256[4] memory) {
        return _selected;
    }
}
