// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";

/// @title Eq. 2 and the ranking of Algorithm 2 in fixed point
/// @notice QoV is one fraction, floored once, so that rounding cannot turn the order of two proposals round: with the
/// demand, payment and reputation as integers the only irrational term is the distance, floored at 1e-16 m.
/// `skyrelay.selection.fixed_point` is the same arithmetic in Python.
library Quality {
    /// One unit of distance (0.1 m) inside the square root.
    uint256 internal constant DISTANCE_SCALE = 1e15;
    uint256 internal constant MAX_REPUTATION = 10_000;
    /// QoV of 100 [1e-15], per weight unit [1e-6].
    uint256 private constant QOV_PER_WEIGHT = 1e11;

    /// @notice Euclidean distance [1e-16 m], floored.
    function distance(int256 dx, int256 dy) internal pure returns (uint256) {
        unchecked {
            // |dx|, |dy| < 2^33, hence the radicand < 2^67 * 2^100.
            return Math.sqrt(uint256(dx * dx + dy * dy) * (DISTANCE_SCALE * DISTANCE_SCALE));
        }
    }

    /// @notice The fraction's coefficients for demand, payment, reputation, closeness, and its denominator.
    /// @dev Weights at most 1e6, maxima below 2^32: every product stays below 2^220.
    function coefficients(uint32[4] memory weights, uint256 maxDemand, uint256 maxPayment, uint256 maxDistance)
        internal
        pure
        returns (uint256[4] memory numerators, uint256 denominator)
    {
        uint256 scaledDistance = maxDistance * DISTANCE_SCALE;
        numerators[0] = QOV_PER_WEIGHT * weights[0] * maxPayment * MAX_REPUTATION * scaledDistance;
        numerators[1] = QOV_PER_WEIGHT * weights[1] * maxDemand * MAX_REPUTATION * scaledDistance;
        numerators[2] = QOV_PER_WEIGHT * weights[2] * maxDemand * maxPayment * scaledDistance;
        numerators[3] = QOV_PER_WEIGHT * weights[3] * maxDemand * maxPayment * MAX_REPUTATION;
        denominator = maxDemand * maxPayment * MAX_REPUTATION * scaledDistance;
    }

    /// @notice QoV / sqrt(demand) [1e-17], floored. At most 1e19, for `qov` at most 1e17 and `demand` at least 1.
    function score(uint256 qov, uint256 demand) internal pure returns (uint256) {
        unchecked {
            return Math.sqrt(qov * qov * 1e4 / demand);
        }
    }
}
