// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ISkyRelayTypes} from "./ISkyRelayTypes.sol";

/// @title SkyRelay: selection of UAV relays for connected vehicles (Table "Functions")
/// @notice Members keep their own record; vehicles propose to UAVs of their zone; the coordinator runs Algorithm 2;
/// a trained policy is assigned to each zone by content address. Every state change emits an event, and the events
/// alone suffice to rebuild every selection.
interface ISkyRelay is ISkyRelayTypes {
    /// @notice Register the caller as a UAV with the initial reputation; `zone` 0 puts it into the pool.
    function registerUAV(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth, uint32 zone) external;

    /// @notice Register the caller as a vehicle with the initial reputation.
    function registerVehicle(int32 x, int32 y, uint32 payment, uint32 zone) external;

    /// @notice Rewrite the caller's vehicle record. A change of zone withdraws its proposal or selection.
    function updateVehicleInfo(int32 x, int32 y, uint32 payment, uint32 zone) external;

    /// @notice Rewrite the caller's UAV record. Battery 0 voids its proposals and selections; otherwise bandwidth may
    /// not fall below what is committed in the current period.
    function updateUAVInfo(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth) external;

    /// @notice Move the calling UAV to `zone`; 0 leaves. Its proposals and selections are void.
    function updateUAVZone(address uav, uint32 zone) external;

    /// @notice Propose to `uav`, asking for `demand`. QoV and score are computed here, from the stored records.
    /// @param round the zone's round that the proposal is for: one that comes late is refused.
    function submitVehSelection(address uav, uint32 demand, uint32 round) external;

    /// @notice Algorithm 2 over the UAVs of a zone, in pieces. The first piece closes the zone to proposals, the last
    /// one opens the next round.
    /// @param maxProposals stop before a UAV that would bring the piece above so many (a UAV without new proposals
    /// counts as one); the first UAV of a piece is always decided.
    /// @return done true when every proposal of the zone is decided.
    function allocateZone(uint32 zone, uint256 maxProposals) external returns (bool done);

    /// @notice Close the period: all proposals, selections and the model of the zone are void.
    function resetListsForZone(uint32 zone) external;

    /// @notice Void the proposals to and the selections by one UAV; by itself or the coordinator.
    function resetUAVSubmission(address uav) external;

    /// @notice Assign the zone the model that fits its numbers of selected UAVs and vehicles best: least UAVs outside
    /// the trained range, then least vehicles outside, then the highest score, then the first registered.
    function determineMDRLModel(uint32 zone) external returns (bytes32 modelId);

    /// @notice UAVs of a zone, in list order.
    function getZoneUAV(uint32 zone) external view returns (address[] memory);

    /// @notice A UAV's record, and what is left of its bandwidth in the current period.
    function getUAVInfo(address uav) external view returns (UAVInfo memory);

    /// @notice Eq. 2 and QoV/sqrt(RB) as a proposal would get them now.
    function quality(address vehicle, address uav, uint32 demand) external view returns (uint64 qov, uint64 score);
}
