// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ProposalHeap} from "../src/libraries/ProposalHeap.sol";
import {Quality} from "../src/libraries/Quality.sol";
import {Test} from "./Vm.sol";

contract HeapAndQualityTest is Test {
    function testFuzz_heapGivesWordsInDescendingOrder(uint256[] memory words) public pure {
        uint256 sum;
        for (uint256 i = 0; i < words.length; ++i) {
            unchecked {
                sum += words[i];
            }
        }
        ProposalHeap.build(words, words.length);
        uint256 last = type(uint256).max;
        for (uint256 size = words.length; size != 0; --size) {
            uint256 word = ProposalHeap.pop(words, size);
            check(word <= last, "descending");
            last = word;
            unchecked {
                sum -= word;
            }
        }
        equal(sum, 0, "each word once");
    }

    function testFuzz_keepFittingKeepsExactlyThose(uint256[] memory words, uint32 left) public pure {
        uint256 fitting;
        for (uint256 i = 0; i < words.length; ++i) {
            if (uint32(words[i]) <= left) ++fitting;
        }
        uint256 size = ProposalHeap.keepFitting(words, words.length, left);
        equal(size, fitting, "kept");
        uint256 last = type(uint256).max;
        for (; size != 0; --size) {
            uint256 word = ProposalHeap.pop(words, size);
            check(word <= last && uint32(word) <= left, "fits, descending");
            last = word;
        }
    }

    function testFuzz_scoreIsTheFlooredSquareRoot(uint64 qov, uint32 demand) public pure {
        uint256 q = qov % (1e17 + 1);
        uint256 d = bound(demand, 1, type(uint32).max);
        uint256 score = Quality.score(q, d);
        uint256 square = q * q * 1e4 / d;
        check(score * score <= square && square < (score + 1) * (score + 1), "floor");
        check(score <= 1e19, "fits 64 bits");
    }

    function testFuzz_distanceIsTheFlooredSquareRoot(int32 x, int32 y, int32 u, int32 v) public pure {
        int256 dx = int256(x) - u;
        int256 dy = int256(y) - v;
        uint256 square = uint256(dx * dx + dy * dy) * 1e30;
        uint256 d = Quality.distance(dx, dy);
        check(d * d <= square && square < (d + 1) * (d + 1), "floor");
    }
}
