// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {ISkyRelayTypes} from "./interfaces/ISkyRelayTypes.sol";
import {Quality} from "./libraries/Quality.sol";
import {Member} from "./libraries/Records.sol";

/// @title The parameters, and Eq. 2: what a selection is worked out by, on the chain or against a claim
abstract contract SkyRelayRules is ISkyRelayTypes {
    bytes32 private constant DOMAIN =
        keccak256("EIP712Domain(string name,string version,uint256 chainId,address verifyingContract)");
    bytes32 private constant PROPOSAL = keccak256(
        "Proposal(address uav,uint32 zone,uint32 round,int32 x,int32 y,uint32 payment,uint32 demand,uint32 since)"
    );
    uint256 private constant WEIGHT_SUM = 1e6;
    /// @dev Battery and reputation of 100.
    uint256 internal constant HUNDRED = 10_000;

    uint256 private immutable DEMAND_COEFFICIENT;
    uint256 private immutable PAYMENT_COEFFICIENT;
    uint256 private immutable REPUTATION_COEFFICIENT;
    uint256 private immutable CLOSENESS_COEFFICIENT;
    uint256 private immutable DENOMINATOR;
    uint256 internal immutable MAX_DISTANCE; // [1e-16 m]
    bool internal immutable RANGE_GATE;
    uint256 internal immutable MAX_DEMAND;
    uint256 internal immutable MAX_PAYMENT;
    uint256 private immutable STALE_AFTER;

    constructor(Parameters memory p) {
        uint256 qou = 0;
        uint256 qov = 0;
        for (uint256 i = 0; i < 4; ++i) {
            qou += p.qouWeights[i];
            qov += p.qovWeights[i];
        }
        if (
            qou != WEIGHT_SUM || qov != WEIGHT_SUM || p.maxBandwidth == 0 || p.maxDemand == 0 || p.maxPayment == 0
                || p.maxDistance == 0 || p.initialReputation > HUNDRED || p.ratingStep > HUNDRED || p.channels == 0
                || p.actions == 0
        ) revert InvalidParameters();
        (uint256[4] memory numerators, uint256 denominator) =
            Quality.coefficients(p.qovWeights, p.maxDemand, p.maxPayment, p.maxDistance);
        DEMAND_COEFFICIENT = numerators[0];
        PAYMENT_COEFFICIENT = numerators[1];
        REPUTATION_COEFFICIENT = numerators[2];
        CLOSENESS_COEFFICIENT = numerators[3];
        DENOMINATOR = denominator;
        MAX_DISTANCE = p.maxDistance * Quality.DISTANCE_SCALE;
        RANGE_GATE = p.rangeGate;
        MAX_DEMAND = p.maxDemand;
        MAX_PAYMENT = p.maxPayment;
        STALE_AFTER = p.staleAfter;
    }

    function _isStale(Member u) internal view returns (bool) {
        return STALE_AFTER != 0 && block.timestamp > u.timestamp() + STALE_AFTER;
    }

    /// @dev Eq. 2, the score of Algorithm 2 [1e-17], and how far apart the two are [1e-16 m].
    function _quality(Member v, Member u, uint256 demand)
        internal
        view
        returns (uint256 qov, uint256 score, uint256 distance)
    {
        unchecked {
            distance = Quality.distance(v.x() - u.x(), v.y() - u.y());
            // Each term is below 2^218: see Quality.coefficients.
            qov = (
                DEMAND_COEFFICIENT * demand + PAYMENT_COEFFICIENT * v.payment()
                    + REPUTATION_COEFFICIENT * v.reputation()
                    + CLOSENESS_COEFFICIENT * Math.saturatingSub(MAX_DISTANCE, distance)
            ) / DENOMINATOR;
        }
        score = Quality.score(qov, demand);
    }

    /// @dev EIP-712's domain of SkyRelay. Not OpenZeppelin's, which knows no contract's but its own, and brings 900 bytes.
    function _domain(address relay) internal view returns (bytes32) {
        return keccak256(abi.encode(DOMAIN, keccak256("SkyRelay"), keccak256("1"), block.chainid, relay));
    }

    /// @dev EIP-712's hash of a proposal: what its vehicle signs, with the domain before it.
    function _proposalHash(address uav, uint256 zone, uint256 round, uint256 terms) internal pure returns (bytes32) {
        return keccak256(
            abi.encode(
                PROPOSAL,
                uav,
                zone,
                round,
                int32(uint32(terms)),
                int32(uint32(terms >> 32)),
                uint32(terms >> 64),
                uint32(terms >> 96),
                uint32(terms >> 128)
            )
        );
    }
}
