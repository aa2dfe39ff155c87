// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {ISkyRelayTypes} from "./ISkyRelayTypes.sol";

/// @title SkyRelay: selection of UAV relays for connected vehicles (Table "Functions")
/// @notice What members call. They keep their own record; vehicles propose to UAVs of their zone. What the consortium
/// calls (Algorithm 2, models, roles) and the views are in ISkyRelayExtension. Every state change emits an event, and
/// the events alone suffice to rebuild every selection.
interface ISkyRelay is ISkyRelayTypes {
    /// @notice Register the caller as a UAV with the initial reputation; `zone` 0 puts it into the pool.
    function registerUAV(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth, uint32 zone) external;

    /// @notice Register the caller as a vehicle with the initial reputation.
    function registerVehicle(int32 x, int32 y, uint32 payment, uint32 zone) external;

    /// @notice Rewrite the caller's vehicle record. While a proposal of it is open or selected it stays as it is; a
    /// change of zone gives the proposal or the selection up.
    function updateVehicleInfo(int32 x, int32 y, uint32 payment, uint32 zone) external;

    /// @notice Rewrite the caller's UAV record. Battery 0 voids its proposals and selections; otherwise bandwidth may
    /// not fall once a vehicle has proposed in the current period.
    function updateUAVInfo(int32 x, int32 y, uint16 altitude, uint16 battery, uint32 bandwidth) external;

    /// @notice Move the calling UAV to `zone`; 0 leaves. Its proposals and selections are void.
    function updateUAVZone(address uav, uint32 zone) external;

    /// @notice Propose to `uav`, asking for `demand`. QoV and score are computed here, from the stored records.
    /// @param round the zone's round that the proposal is for: one that comes late is refused.
    function submitVehSelection(address uav, uint32 demand, uint32 round) external;

    /// @notice Void the proposals to and the selections by one UAV, which takes no others in the period; by itself, and
    /// by anyone where it is stale or suspended.
    function resetUAVSubmission(address uav) external;
}
