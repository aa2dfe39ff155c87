// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {IAccessControlDefaultAdminRules} from
    "@openzeppelin/contracts/access/extensions/IAccessControlDefaultAdminRules.sol";
import {ISkyRelay} from "../src/interfaces/ISkyRelay.sol";
import {ISkyRelayExtension} from "../src/interfaces/ISkyRelayExtension.sol";
import {ISkyRelayTypes} from "../src/interfaces/ISkyRelayTypes.sol";
import {Test} from "./Vm.sol";

/// @notice What SkyRelay answers: both interfaces, and its roles.
interface IRelay is ISkyRelay, ISkyRelayExtension, IAccessControlDefaultAdminRules {
    function COORDINATOR_ROLE() external view returns (bytes32);
    function PUBLISHER_ROLE() external view returns (bytes32);
    function REPUTATION_ROLE() external view returns (bytes32);
    function REGISTRAR_ROLE() external view returns (bytes32);
    function SETTLER_ROLE() external view returns (bytes32);
}

/// @notice A deployed SkyRelay, this contract holding all its roles, and named members.
abstract contract Fixture is Test, ISkyRelayTypes {
    IRelay internal relay;

    function parameters() internal pure virtual returns (Parameters memory) {
        return Parameters({
            qouWeights: [uint32(250_000), 250_000, 250_000, 250_000],
            qovWeights: [uint32(250_000), 250_000, 250_000, 250_000],
            maxBandwidth: 20_000,
            maxDemand: 4_000,
            maxPayment: 700,
            maxDistance: 30_000,
            rangeGate: true,
            initialReputation: 5_000,
            ratingStep: 100,
            observationSide: 11,
            channels: 6,
            actions: 9,
            admission: false,
            staleAfter: 3_600,
            allocationDeadline: 60,
            minimumPeriod: 0,
            adminDelay: 1 days,
            settling: 0
        });
    }

    /// @dev The compiled code that the package ships; for the coverage, what the sources give. No test contract has the
    /// contract in it: each would have it optimised anew, for minutes.
    function code(string memory name) internal view returns (bytes memory) {
        if (vm.envOr("SKYRELAY_FROM_SOURCE", false)) return vm.getCode(string.concat(name, ".sol"));
        return vm.getCode(string.concat("../src/skyrelay/chain/artifacts/", name, ".json"));
    }

    function create(bytes memory creation) internal returns (address created) {
        assembly ("memory-safe") {
            created := create(0, add(creation, 0x20), mload(creation))
        }
    }

    function newExtension(Parameters memory p) internal returns (address) {
        return create(bytes.concat(code("SkyRelayExtension"), abi.encode(p)));
    }

    function newRelay(Parameters memory p, address extension) internal returns (address) {
        return create(bytes.concat(code("SkyRelay"), abi.encode(p, extension)));
    }

    function newClaims(Parameters memory p, uint256 bond, uint256 supply) internal returns (address claims) {
        claims = create(bytes.concat(code("OptimisticSelection"), abi.encode(p, relay, bond, supply)));
        relay.grantRole(relay.SETTLER_ROLE(), claims);
    }

    function deploy() internal {
        relay = IRelay(newRelay(parameters(), newExtension(parameters())));
        check(address(relay) != address(0), "deployed");
        relay.grantRole(relay.COORDINATOR_ROLE(), address(this));
        relay.grantRole(relay.PUBLISHER_ROLE(), address(this));
        relay.grantRole(relay.REPUTATION_ROLE(), address(this));
        relay.grantRole(relay.REGISTRAR_ROLE(), address(this));
    }

    function uav(uint256 i) internal pure returns (address) {
        return address(uint160(0x1000 + i));
    }

    function vehicle(uint256 i) internal pure returns (address) {
        return address(uint160(0x100000 + i));
    }

    function addUAV(uint256 i, uint32 bandwidth, uint32 zone) internal returns (address member) {
        member = uav(i);
        vm.prank(member);
        relay.registerUAV(int32(int256(i)), 0, 100, 9_000, bandwidth, zone);
    }

    function addVehicle(uint256 i, uint32 payment, uint32 zone) internal returns (address member) {
        member = vehicle(i);
        vm.prank(member);
        relay.registerVehicle(int32(int256(i)), 0, payment, zone);
    }

    function submit(address member, address to, uint32 demand, uint32 inRound) internal {
        vm.prank(member);
        relay.submitVehSelection(to, demand, inRound);
    }

    function allocate(uint32 zone) internal {
        check(relay.allocateZone(zone, type(uint256).max), "allocated in one piece");
    }

    function zoneUAVs(uint32 zone) internal view returns (address[] memory) {
        return relay.getZoneUAV(zone, 0, type(uint256).max);
    }

    function status(address member) internal view returns (ProposalStatus found) {
        (found,,) = relay.getVehicleSelection(member);
    }

    function round(uint32 zone) internal view returns (uint32) {
        return relay.getZoneInfo(zone).round;
    }
}
