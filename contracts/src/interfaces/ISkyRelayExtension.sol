// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Member} from "../libraries/Records.sol";
import {ISkyRelayTypes} from "./ISkyRelayTypes.sol";

/// @title What the consortium calls: allocation, models, reputations, admission; ratings; and the views
/// @notice Called at the address of SkyRelay, which passes on what it does not know itself.
interface ISkyRelayExtension is ISkyRelayTypes {
    /// @notice Make the deployer administrator. SkyRelay's constructor calls it; nobody else can.
    function initialise(address administrator) external;

    /// @notice Give a zone a coordinator of its own, who alone acts on it from then on; 0: the holders of
    /// COORDINATOR_ROLE again. By the administrator.
    function setZoneCoordinator(uint32 zone, address coordinator) external;

    /// @notice Let an address register as this kind of member (1 UAV, 2 vehicle), by a registrar's signature of
    /// `Voucher(address member,uint8 kind,uint256 expires)`, EIP-712. Anyone may hand it in, until it expires [s].
    function admit(address member, uint8 kind, uint256 expires, bytes calldata signature) external;

    /// @notice Keep a member from proposing or being proposed to, or let it again. By a registrar. Either way its
    /// proposals and selections are void.
    function suspendMember(address member, bool suspended) external;

    /// @notice Have a zone take no proposals, or let it again. By a registrar.
    function suspendZone(uint32 zone, bool suspended) external;

    /// @notice Hand in proposals that vehicles have signed, for the present round of each UAV's zone; anyone may. What
    /// submitVehSelection would refuse, or is signed for anything else, is passed over.
    /// @return taken how many were taken.
    function submitSigned(SignedBatch[] calldata batches) external returns (uint256 taken);

    /// @notice Algorithm 2 over the UAVs of a zone, in pieces. The first piece closes the zone to proposals, the last
    /// one opens the next round. By the zone's coordinator; by anyone once an allocation has begun, or when the
    /// deadline after the round's first proposal has passed: it takes no choice.
    /// @param maxProposals stop before a UAV that would bring the piece above so many (a UAV without new proposals
    /// counts as one); the first UAV of a piece is always decided.
    /// @return done true when every proposal of the zone is decided.
    function allocateZone(uint32 zone, uint256 maxProposals) external returns (bool done);

    /// @notice Close the period, in which every proposal must be decided: all proposals, selections and the model of the
    /// zone are void. By the zone's coordinator, not before the minimum period is over; by anyone when that and the
    /// deadline after the last allocation have passed.
    function resetListsForZone(uint32 zone) external;

    /// @notice Assign the zone the model that fits its numbers of selected UAVs and vehicles best: least UAVs outside
    /// the trained range, then least vehicles outside, then the highest score, then the first registered. By the zone's coordinator;
    /// by anyone where the period has no model and the deadline after the last allocation has passed.
    function determineMDRLModel(uint32 zone) external returns (bytes32 modelId);

    /// @notice End a zone's round with what was claimed for it: so many UAVs and vehicles selected more than before, or
    /// less. The zone takes no proposals until its period ends. By the contract that takes claims, for the zone's coordinator.
    /// @return period that it belongs to.
    function settle(uint32 zone, uint32 round, address coordinator, int256 uavs, int256 vehicles)
        external
        returns (uint32 period);

    /// @notice A claim of this period was wrong: nobody is selected, and proposals are taken again. By the contract that
    /// takes claims; nothing happens where the period is over.
    function unsettle(uint32 zone, uint32 period) external;

    /// @notice Members' packed records (`libraries/Records.sol`); reputation and suspension as they were after a block.
    /// @dev What was longer ago than `settling` blocks is not known.
    function recordsAt(address[] calldata members, uint256 number) external view returns (Member[] memory);

    /// @notice Publish a model. Its id is the hash of its owner, CID and card.
    /// @param cid binary CIDv1 with a sha2-256 multihash (36 bytes).
    function registerModel(bytes calldata cid, ModelCard calldata card) external returns (bytes32 modelId);

    /// @notice Take a model out of use, by its owner or an admin. Zones that it was assigned to keep it.
    function retireModel(bytes32 modelId) external;

    /// @notice Set reputations by the consortium's authority.
    function setReputations(address[] calldata members, uint16[] calldata reputations) external;

    /// @notice Rate the UAV that selected the calling vehicle in its last finished session that served anybody, once.
    function rateUAV(address uav, bool good) external;

    /// @notice Rate a vehicle that the calling UAV selected in its last finished session that served anybody, once,
    /// even if the vehicle gave the selection up.
    /// @param index of the vehicle's proposal in that session.
    function rateVehicle(address vehicle, uint16 index, bool good) external;

    /// @notice At most so many UAVs of a zone from a place in its list on, in list order.
    function getZoneUAV(uint32 zone, uint256 first, uint256 most) external view returns (address[] memory);

    /// @notice A UAV's record, and what is left of its bandwidth in the current period.
    function getUAVInfo(address uav) external view returns (UAVInfo memory);

    /// @notice Eq. 2 and QoV/sqrt(RB) as a proposal would get them now.
    function quality(address vehicle, address uav, uint32 demand) external view returns (uint64 qov, uint64 score);

    /// @notice A vehicle's record.
    function getVehicleInfo(address vehicle) external view returns (VehicleInfo memory);

    /// @notice Of at most so many UAVs of a zone from a place in its list on, those that serve a vehicle.
    function getSelectedUAVs(uint32 zone, uint256 first, uint256 most) external view returns (address[] memory);

    /// @notice A zone at this moment.
    function getZoneInfo(uint32 zone) external view returns (ZoneInfo memory);

    /// @notice The current period's proposals to a UAV, by index.
    function getProposals(address uav) external view returns (VehicleSelection[] memory);

    /// @notice The vehicle's latest proposal in the current period.
    function getVehicleSelection(address vehicle)
        external
        view
        returns (ProposalStatus status, address uav, uint16 index);

    /// @notice How many UAVs are registered.
    function uavCount() external view returns (uint256);

    /// @notice The UAV at a place in the list of all; those of zone 0 are the pool.
    function uavAt(uint256 index) external view returns (address);

    /// @notice How many models are in use.
    function modelCount() external view returns (uint256);

    /// @notice The id of the model at a place in the list of those in use, the first registered first.
    function modelAt(uint256 index) external view returns (bytes32);

    /// @notice A model, also one that is retired; `cid` is the binary CIDv1.
    function getModel(bytes32 modelId)
        external
        view
        returns (bytes memory cid, ModelCard memory card, address owner, bool retired);
}
