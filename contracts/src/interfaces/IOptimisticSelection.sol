// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Member} from "../libraries/Records.sol";
import {ISkyRelayTypes} from "./ISkyRelayTypes.sol";

/// @title Selections by claim: worked out off the chain, proposals as calldata, a bond against every wrong UAV
/// @notice A zone's coordinator claims the rounds of a period, one after the other. Nothing of a proposal is checked or stored
/// but a hash; whoever finds that a claim is wrong proves it from its calldata, by replaying the one UAV that is, gets half of the
/// bond (the rest is burnt), and the zone's period goes on as SkyRelay's own. The bond is this contract's token, whose whole supply the deployer has.
/// @dev A proposal is signed as for `submitSigned`, with a `since` of 0: its round, which never comes again, has it count
/// once. At a UAV a vehicle proposes once a period.
interface IOptimisticSelection is ISkyRelayTypes {
    /// @notice What is claimed of one UAV in a round.
    struct Share {
        address uav;
        /// Bit i: it serves the proposal i after this round, counted in the order claimed, from the period's first.
        uint256 selected;
        /// How many it served before this round.
        uint256 before;
        /// New in this round: 1 to 128; at most 255 in a period.
        SignedProposal[] proposals;
    }

    /// @notice One UAV's place in a round's hash.
    struct Leaf {
        address uav;
        bytes32 share;
    }

    /// @notice A claimed round, shown again by whoever questions it.
    struct Round {
        uint32 round;
        /// Of all UAVs with a share in it, in the order claimed.
        Leaf[] leaves;
        /// Position and bandwidth of the UAV in question, as packed in its record when the round was claimed, and its share;
        /// where it has none, anything.
        Member record;
        Share share;
    }

    /// @notice A UAV's part of a period, as far as the rounds shown.
    struct Part {
        address uav;
        Round[] rounds;
    }

    /// @notice Where the claims of a zone's period stand.
    enum State {
        None,
        Open,
        Final,
        Void
    }

    /// @notice A round of a zone is claimed; what, is in the transaction.
    event Claimed(uint32 indexed zone, uint32 period, uint32 round, address indexed claimant);
    /// @notice A claim of a zone's period was wrong: half of the claimant's bond is the challenger's, half is gone.
    event ClaimVoided(uint32 indexed zone, uint32 period, address indexed claimant, address indexed challenger);
    /// @notice Nobody can question the period's claims any more: the bond is the claimant's again.
    event ClaimFinal(uint32 indexed zone, uint32 period, address indexed claimant);

    /// @notice UAVs in rising order, each of the zone, with power, heard of lately and not suspended, with a new proposal.
    error UnfitShare(address uav);
    /// @notice A proposal that would be refused, or not Algorithm 2's choice.
    error WrongShare(address uav);
    /// @notice The period has claims by another, or as of another block; or too many; or one of them was wrong.
    error NotYourPeriod(uint32 zone, uint32 period);
    /// @notice Too late to claim, or as of a block that is to come or too long ago.
    error OutOfTime(uint256 asOf);
    /// @notice The period's claims cannot be questioned, or not yet be final.
    error NotInState(State state);
    /// @notice What was shown is not what was claimed.
    error NotClaimed();
    /// @notice What was shown is not wrong.
    error ClaimHolds();

    /// @notice Claim a zone's present round, of at most 64 UAVs and as one of six in its period, by its coordinator. The first claim of a period takes the bond.
    /// @param asOf the block after which vehicles had the reputations that it was worked out with; the same all period.
    function claim(uint32 zone, uint32 round, uint48 asOf, Share[] calldata shares) external;

    /// @notice Decide a zone's present round, the only one of its period, by its coordinator, with everything checked at once:
    /// no bond, and nothing left to question. Reverts where the shares are not what SkyRelay would have come to.
    function prove(uint32 zone, uint32 round, Share[] calldata shares) external;

    /// @notice Prove one UAV's share wrong in some of the rounds from the period's first on: a proposal that the contract would
    /// have refused, a forged one, or a choice that is not Algorithm 2's.
    function challenge(uint32 zone, uint32 period, Part calldata part) external;

    /// @notice Prove that a vehicle's proposals `i` and `j`, in the last round shown, were both taken in: in one round,
    /// at one UAV, or the second while it was served.
    function challengeTwice(uint32 zone, uint32 period, Part calldata first, uint256 i, Part calldata second, uint256 j)
        external;

    /// @notice Prove that the last round shown lacks a proposal that the claimant signed to take in:
    /// `Acknowledgement(bytes32 proposal,uint256 deadline)`, EIP-712 of SkyRelay.
    function challengeOmission(
        uint32 zone,
        uint32 period,
        Part calldata part,
        SignedProposal calldata proposal,
        uint256 deadline,
        bytes calldata acknowledgement
    ) external;

    /// @notice Give the bond of a period back when its claims cannot be questioned any more; anyone may.
    function finalise(uint32 zone, uint32 period) external;

    /// @notice Where a period's claims stand: by whom, as of which block, how many rounds, and until which block they can be questioned.
    function claims(uint32 zone, uint32 period)
        external
        view
        returns (State state, address claimant, uint48 asOf, uint8 count, uint256 until);
}
