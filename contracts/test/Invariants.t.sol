// SPDX-License-Identifier: Apache-2.0
pragma solidity 0.8.26;

import {Fixture} from "./Fixture.sol";

/// @notice Members, a coordinator and strangers who do what they like, in any order.
contract Handler is Fixture {
    uint256 internal constant UAVS = 5;
    uint256 internal constant VEHICLES = 14;
    uint32 internal constant ZONES = 3;

    /// @dev A record as its owner left it, or 0.
    mapping(address member => bytes32 record) public expected;
    /// @dev What should have reverted and did not. (A check inside an action would only revert that action.)
    string public violation;
    uint256 public submitted;
    uint256 public allocated;
    uint256 public ratings;

    constructor() {
        deploy();
        for (uint256 i = 0; i < UAVS; ++i) {
            addUAV(i, uint32(1_000 + 1_500 * i), uint32(1 + i % ZONES));
            remember(uav(i));
        }
        for (uint256 i = 0; i < VEHICLES; ++i) {
            addVehicle(i, uint32(50 * i), uint32(1 + i % ZONES));
            remember(vehicle(i));
        }
    }

    function zoneOf(uint256 seed) private pure returns (uint32) {
        return uint32(1 + seed % ZONES);
    }

    function record(address member) public view returns (bytes32) {
        if (uint160(member) < 0x100000) {
            UAVInfo memory u = relay.getUAVInfo(member);
            return keccak256(abi.encode(u.x, u.y, u.altitude, u.battery, u.bandwidth, u.zone));
        }
        VehicleInfo memory v = relay.getVehicleInfo(member);
        return keccak256(abi.encode(v.x, v.y, v.payment, v.zone));
    }

    function remember(address member) private {
        expected[member] = record(member);
    }

    function propose(uint256 v, uint256 u, uint256 demand, uint256 lateness) public {
        address to = uav(u % UAVS);
        uint32 zone = relay.getUAVInfo(to).zone;
        if (zone == 0) return;
        uint32 current = round(zone);
        uint32 given = lateness % 8 == 0 ? current - 1 : lateness % 8 == 1 ? current + 1 : current;
        vm.prank(vehicle(v % VEHICLES));
        relay.submitVehSelection(to, uint32(bound(demand, 1, 4_000)), given);
        if (given != current) violation = "a proposal for another round was taken";
        ++submitted;
    }

    function proposeInOwnZone(uint256 v, uint256 pick, uint256 demand) public {
        uint32 zone = relay.getVehicleInfo(vehicle(v % VEHICLES)).zone;
        if (zone == 0) return;
        address[] memory uavs = zoneUAVs(zone);
        if (uavs.length == 0) return;
        vm.prank(vehicle(v % VEHICLES));
        relay.submitVehSelection(uavs[pick % uavs.length], uint32(bound(demand, 1, 4_000)), round(zone));
        ++submitted;
    }

    function allocate(uint256 zone, uint256 pieces) public {
        relay.allocateZone(zoneOf(zone), bound(pieces, 1, 12));
        ++allocated;
    }

    function everyoneProposes(uint256 zone, uint256 pick, uint256 demand) public {
        address[] memory uavs = zoneUAVs(zoneOf(zone));
        if (uavs.length == 0) return;
        uint32 current = round(zoneOf(zone));
        for (uint256 i = 0; i < VEHICLES; ++i) {
            address to = uavs[(pick + i) % uavs.length];
            vm.prank(vehicle(i));
            try relay.submitVehSelection(to, uint32(bound(demand / (i + 1), 1, 4_000)), current) {
                ++submitted;
            } catch {}
        }
    }

    /// @dev Seldom, or nothing else would get far.
    function reset(uint256 zone, uint256 chance) public {
        if (chance % 4 != 0) return;
        relay.resetListsForZone(zoneOf(zone));
    }

    function moveVehicle(uint256 v, int16 x, int16 y, uint256 zone) public {
        vm.prank(vehicle(v % VEHICLES));
        relay.updateVehicleInfo(x, y, uint32(zone % 701), uint32(zone % (ZONES + 1)));
        remember(vehicle(v % VEHICLES));
    }

    function updateUAV(uint256 u, int16 x, uint256 battery, uint256 bandwidth) public {
        vm.prank(uav(u % UAVS));
        relay.updateUAVInfo(x, 0, 50, uint16(battery % 5 == 0 ? 0 : battery % 10_001), uint32(bandwidth % 8_000));
        remember(uav(u % UAVS));
    }

    function moveUAV(uint256 u, uint256 zone) public {
        vm.prank(uav(u % UAVS));
        relay.updateUAVZone(uav(u % UAVS), uint32(zone % (ZONES + 1)));
        remember(uav(u % UAVS));
    }

    function resetUAV(uint256 u, bool byItself, uint256 chance) public {
        if (chance % 4 != 0) return;
        if (byItself) vm.prank(uav(u % UAVS));
        relay.resetUAVSubmission(uav(u % UAVS));
    }

    /// @dev Whoever may rate a UAV does, and the UAV rates back where it can; nobody does so twice.
    function rate(uint256 u, bool good) public {
        address rated = uav(u % UAVS);
        for (uint256 i = 0; i < VEHICLES; ++i) {
            uint256 before = relay.getUAVInfo(rated).reputation;
            vm.prank(vehicle(i));
            try relay.rateUAV(rated, good) {
                ++ratings;
                uint256 after_ = relay.getUAVInfo(rated).reputation;
                if (after_ > before + 100 || before > after_ + 100) violation = "a rating moved too far";
                vm.prank(vehicle(i));
                try relay.rateUAV(rated, good) {
                    violation = "a vehicle rated twice";
                } catch {}
            } catch {}
            for (uint16 index = 0; index < 4; ++index) {
                vm.prank(rated);
                try relay.rateVehicle(vehicle(i), index, good) {
                    ++ratings;
                    vm.prank(rated);
                    try relay.rateVehicle(vehicle(i), index, good) {
                        violation = "a UAV rated twice";
                    } catch {}
                } catch {}
            }
        }
    }

    function attack(address stranger, uint256 u, uint32 zone) public {
        if (stranger == address(this) || stranger == uav(u % UAVS)) return;
        vm.prank(stranger);
        relay.updateUAVZone(uav(u % UAVS), zone);
        violation = "a stranger moved a UAV";
    }

    // What must hold after anything

    function checkAll() public view {
        check(bytes(violation).length == 0, violation);
        uint256[VEHICLES] memory served;
        uint256 selectedInAll;
        for (uint32 zone = 1; zone <= ZONES; ++zone) {
            selectedInAll += checkZone(zone, served);
        }
        uint256 selected;
        for (uint256 i = 0; i < VEHICLES; ++i) {
            check(served[i] <= 1, "a vehicle is served twice");
            if (status(vehicle(i)) == ProposalStatus.Selected) ++selected;
            check(record(vehicle(i)) == expected[vehicle(i)], "a vehicle's record was written by another");
        }
        equal(selected, selectedInAll, "selected vehicles");
        for (uint256 i = 0; i < UAVS; ++i) {
            check(record(uav(i)) == expected[uav(i)], "a UAV's record was written by another");
        }
    }

    function checkZone(uint32 zone, uint256[VEHICLES] memory served) private view returns (uint256 vehicles) {
        address[] memory uavs = zoneUAVs(zone);
        uint256 selecting;
        for (uint256 i = 0; i < uavs.length; ++i) {
            uint256 held = checkUAV(uavs[i], zone, served);
            vehicles += held;
            if (held != 0) ++selecting;
        }
        ZoneInfo memory z = relay.getZoneInfo(zone);
        equal(z.selectedVehicles, vehicles, "selected vehicles of a zone");
        equal(z.selectedUAVs, selecting, "selecting UAVs of a zone");
        equal(relay.getSelectedUAVs(zone, 0, type(uint256).max).length, selecting, "list of selecting UAVs");
    }

    function checkUAV(address member, uint32 zone, uint256[VEHICLES] memory served)
        private
        view
        returns (uint256 held)
    {
        UAVInfo memory u = relay.getUAVInfo(member);
        equal(u.zone, zone, "a zone's list holds a UAV of another zone");
        uint256 promised;
        VehicleSelection[] memory proposals = relay.getProposals(member);
        for (uint256 k = 0; k < proposals.length; ++k) {
            VehicleSelection memory p = proposals[k];
            if (p.status == ProposalStatus.None || p.status == ProposalStatus.Rejected) continue;
            checkOpen(p, member, k, zone);
            if (p.status == ProposalStatus.Selected) {
                promised += p.demand;
                ++held;
                ++served[uint160(p.vehicle) - 0x100000];
            }
        }
        check(promised <= u.bandwidth, "a UAV promised more than its bandwidth");
        equal(u.available, u.bandwidth - promised, "available bandwidth");
    }

    /// @dev Open and selected proposals are their vehicle's own, and its only one.
    function checkOpen(VehicleSelection memory p, address member, uint256 k, uint32 zone) private view {
        (ProposalStatus known, address to, uint16 index) = relay.getVehicleSelection(p.vehicle);
        check(known == p.status && to == member && index == k, "a dangling entry");
        equal(relay.getVehicleInfo(p.vehicle).zone, zone, "a vehicle of another zone");
    }

    /// @dev Every zone can be brought to the end of its round, whatever happened, in pieces of any size.
    function finishAll() public {
        for (uint32 zone = 1; zone <= ZONES; ++zone) {
            for (uint256 pieces = 0; !relay.allocateZone(zone, 1); ++pieces) {
                check(pieces <= UAVS, "an allocation does not end");
            }
            relay.resetListsForZone(zone);
            equal(relay.getZoneInfo(zone).selectedVehicles, 0, "reset");
        }
    }
}

contract InvariantTest {
    struct FuzzSelector {
        address addr;
        bytes4[] selectors;
    }

    Handler private handler;

    function setUp() public {
        handler = new Handler();
    }

    function targetContracts() public view returns (address[] memory targets) {
        targets = new address[](1);
        targets[0] = address(handler);
    }

    function targetSelectors() public view returns (FuzzSelector[] memory targets) {
        targets = new FuzzSelector[](1);
        bytes4[] memory actions = new bytes4[](11);
        actions[0] = Handler.propose.selector;
        actions[1] = Handler.proposeInOwnZone.selector;
        actions[2] = Handler.everyoneProposes.selector;
        actions[3] = Handler.allocate.selector;
        actions[4] = Handler.reset.selector;
        actions[5] = Handler.moveVehicle.selector;
        actions[6] = Handler.updateUAV.selector;
        actions[7] = Handler.moveUAV.selector;
        actions[8] = Handler.resetUAV.selector;
        actions[9] = Handler.rate.selector;
        actions[10] = Handler.attack.selector;
        targets[0] = FuzzSelector(address(handler), actions);
    }

    function invariant_selectionsRecordsAndCountsAgree() public view {
        handler.checkAll();
    }

    function afterInvariant() public {
        handler.finishAll();
        handler.checkAll();
    }
}
